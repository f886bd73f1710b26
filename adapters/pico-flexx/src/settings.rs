//! Settings of the camera, as a table that a configuration file can hold.
//!
//! ```toml
//! [camera.settings.pico-flexx]
//! name = "flexx"
//!
//! [camera.settings.pico-flexx.source]
//! kind = "royale"               # or "rosbridge"
//! use_case = "MODE_9_10FPS_1000"
//! ```

use std::path::PathBuf;
use std::time::Duration;

use graspd_adapters_core::check::{SettingsError, require};
use serde::{Deserialize, Serialize};

use crate::use_case::{KNOWN, UseCase};

/// Settings of the adapter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FlexxSettings {
    /// Name for logs and errors.
    pub name: String,
    /// Width and height, pixels: those of the pico flexx. Frames of another size are refused.
    pub size_px: (usize, usize),
    /// Frames a second, where the use case's name does not tell.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame_rate_hz: Option<f64>,
    /// What a frame needs at least from exposure to arrival, milliseconds; left out: a frame's duration, which no measurement
    /// on a camera supports.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub latency_ms: Option<f64>,
    /// Without a frame for so long, milliseconds, a streaming camera counts as lost.
    pub silence_ms: u64,
    /// Pause before a lost camera is looked for again, milliseconds; it doubles up to 16 times this.
    pub retry_ms: u64,
    /// Depth whose noise the camera estimates as more than this is left out, metres.
    pub max_noise_m: f32,
    /// Where frames come from.
    pub source: Source,
}

impl Default for FlexxSettings {
    fn default() -> Self {
        Self {
            name: "pico-flexx".into(),
            size_px: (224, 172),
            frame_rate_hz: None,
            latency_ms: None,
            silence_ms: 3000,
            retry_ms: 500,
            max_noise_m: 0.07,
            source: Source::Royale(RoyaleSettings::default()),
        }
    }
}

/// Where frames come from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Source {
    /// The camera at this machine, through the manufacturer's library.
    Royale(RoyaleSettings),
    /// A ROS driver, through a rosbridge server.
    Rosbridge(RosbridgeSettings),
}

/// Exposure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Exposure {
    /// The library chooses, up to the use case's longest.
    Auto,
    /// This time, microseconds.
    Us(u32),
}

/// The camera at this machine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RoyaleSettings {
    /// Id of the camera, or a recording (`.rrf`) that the library replays as one; left out: the first camera.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera: Option<String>,
    /// The library `libroyaleCAPI.so`, or its folder; left out: `ROYALE_LIB` of the environment, then the system's places.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub library: Option<PathBuf>,
    /// Use case, as the camera names it.
    pub use_case: String,
    /// Exposure.
    pub exposure: Exposure,
    /// Fewer frames a second than the use case has; left out: its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames_per_second: Option<u16>,
    /// Stream of a use case with several; left out: the first that comes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stream: Option<u16>,
    /// Least confidence, 1 to 255, of depth that is kept.
    pub min_confidence: u8,
}

impl Default for RoyaleSettings {
    fn default() -> Self {
        Self {
            camera: None,
            library: None,
            use_case: KNOWN[1].into(),
            exposure: Exposure::Auto,
            frames_per_second: None,
            stream: None,
            min_confidence: 1,
        }
    }
}

/// Which of a driver's topics carries depth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DepthTopic {
    /// `sensor_msgs/Image`: 32FC1 metres or 16UC1 millimetres.
    Image,
    /// `sensor_msgs/PointCloud2`, organized; with a field `noise` the noise is looked at too.
    Points,
}

/// A ROS driver.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RosbridgeSettings {
    /// Address of the rosbridge server, `ws://host:9090`.
    pub url: String,
    /// Which kind of topic carries depth.
    pub depth: DepthTopic,
    /// Topic of depth images or points.
    pub topic: String,
    /// Topic of the lens, `sensor_msgs/CameraInfo`.
    pub camera_info: String,
    /// Use case that the driver was started with: tells rate and range.
    pub use_case: String,
    /// Longest time to connect, milliseconds.
    pub connect_ms: u64,
}

impl Default for RosbridgeSettings {
    fn default() -> Self {
        Self {
            url: "ws://127.0.0.1:9090".into(),
            depth: DepthTopic::Image,
            topic: "/pico_flexx/image_depth".into(),
            camera_info: "/pico_flexx/camera_info".into(),
            use_case: KNOWN[1].into(),
            connect_ms: 3000,
        }
    }
}

impl FlexxSettings {
    /// Name of the use case.
    pub fn use_case(&self) -> &str {
        match &self.source {
            Source::Royale(royale) => &royale.use_case,
            Source::Rosbridge(ros) => &ros.use_case,
        }
    }

    /// Frames a second.
    pub fn rate_hz(&self) -> f64 {
        let fewer = match &self.source {
            Source::Royale(RoyaleSettings { frames_per_second: Some(hz), .. }) => Some(f64::from(*hz)),
            _ => None,
        };
        let named = || UseCase::parse(self.use_case()).map(|case| f64::from(case.hz));
        fewer.or(self.frame_rate_hz).or_else(named).unwrap_or(5.0)
    }

    pub(crate) fn period(&self) -> Duration {
        Duration::from_secs_f64(1.0 / self.rate_hz())
    }

    pub(crate) fn latency(&self) -> Duration {
        self.latency_ms.map_or(self.period(), |ms| Duration::from_secs_f64(ms * 1e-3))
    }

    pub(crate) fn silence(&self) -> Duration {
        Duration::from_millis(self.silence_ms)
    }

    pub(crate) fn retry(&self) -> Duration {
        Duration::from_millis(self.retry_ms)
    }

    /// The same camera at an address: a rosbridge server for one that begins with `ws://`, else the camera of this id, or an
    /// `.rrf` file. What the settings say of that kind of source stays; an empty address changes nothing.
    pub fn with_address(mut self, address: &str) -> Self {
        if address.is_empty() {
            return self;
        }
        self.source = match (self.source, address.starts_with("ws://")) {
            (Source::Rosbridge(source), true) => {
                Source::Rosbridge(RosbridgeSettings { url: address.to_owned(), ..source })
            }
            (Source::Royale(source), true) => Source::Rosbridge(RosbridgeSettings {
                url: address.to_owned(),
                use_case: source.use_case,
                ..RosbridgeSettings::default()
            }),
            (Source::Royale(source), false) => {
                Source::Royale(RoyaleSettings { camera: Some(address.to_owned()), ..source })
            }
            (Source::Rosbridge(source), false) => Source::Royale(RoyaleSettings {
                camera: Some(address.to_owned()),
                use_case: source.use_case,
                ..RoyaleSettings::default()
            }),
        };
        self
    }

    /// Checks every value.
    ///
    /// # Errors
    /// [`SettingsError`] with the first field that is wrong.
    pub fn check(&self) -> Result<(), SettingsError> {
        require("name", format!("{:?}", self.name), !self.name.is_empty(), "a name")?;
        let (width, height) = self.size_px;
        let sides = (1..=MOST_SIDE).contains(&width) && (1..=MOST_SIDE).contains(&height);
        require("size_px", format!("{width} x {height}"), sides, "1 to 2048 along each side")?;
        if let Some(hz) = self.frame_rate_hz {
            require("frame_rate_hz", hz, (0.1..=200.0).contains(&hz), "0.1 to 200")?;
        }
        if let Some(ms) = self.latency_ms {
            require("latency_ms", ms, (0.0..=1000.0).contains(&ms), "0 to 1000")?;
        }
        let noise = self.max_noise_m;
        require("max_noise_m", noise, noise > 0.0 && noise <= 10.0, "above 0, at most 10")?;
        let case = self.use_case();
        let known = UseCase::parse(case).is_some() || self.frame_rate_hz.is_some();
        let expected = format!("a name such as {}, or frame_rate_hz beside it", KNOWN[1]);
        require("source.use_case", format!("{case:?}"), known && plain(case), expected)?;
        match &self.source {
            Source::Royale(royale) => royale.check()?,
            Source::Rosbridge(ros) => ros.check()?,
        }
        let fastest = (3000.0 / self.rate_hz()).ceil() as u64;
        let patient = (fastest..=120_000).contains(&self.silence_ms);
        require("silence_ms", self.silence_ms, patient, format!("{fastest} (three frames) to 120000"))?;
        require("retry_ms", self.retry_ms, (10..=60_000).contains(&self.retry_ms), "10 to 60000")
    }
}

/// Largest side of a frame, pixels.
pub(crate) const MOST_SIDE: usize = 2048;

/// Text that a C function can take.
fn plain(text: &str) -> bool {
    !text.is_empty() && text.len() < 1024 && !text.contains('\0')
}

impl RoyaleSettings {
    fn check(&self) -> Result<(), SettingsError> {
        let camera = self.camera.as_deref().unwrap_or("the first");
        require("source.camera", format!("{camera:?}"), plain(camera), "an id, or a file")?;
        if let Exposure::Us(us) = self.exposure {
            require("source.exposure.us", us, (1..=100_000).contains(&us), "1 to 100000")?;
        }
        if let Some(hz) = self.frames_per_second {
            require("source.frames_per_second", hz, (1..=200).contains(&hz), "1 to 200")?;
        }
        require("source.min_confidence", self.min_confidence, self.min_confidence > 0, "1 to 255")
    }
}

impl RosbridgeSettings {
    fn check(&self) -> Result<(), SettingsError> {
        let url = &self.url;
        // Encrypted links end at a proxy: this build has no TLS.
        let open = url.strip_prefix("ws://").is_some_and(|host| !host.is_empty());
        require("source.url", format!("{url:?}"), open, "ws://host:port")?;
        for (field, topic) in [("source.topic", &self.topic), ("source.camera_info", &self.camera_info)] {
            let named = topic.len() > 1 && topic.starts_with('/') && !topic.contains(char::is_whitespace);
            require(field, format!("{topic:?}"), named, "a topic, /with/its/whole/name")?;
        }
        let ms = self.connect_ms;
        require("source.connect_ms", ms, (10..=60_000).contains(&ms), "10 to 60000")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<FlexxSettings, String> {
        toml::from_str(text).map_err(|error| error.to_string())
    }

    #[test]
    fn settings_survive_a_file() {
        let ros = FlexxSettings {
            source: Source::Rosbridge(RosbridgeSettings::default()),
            ..FlexxSettings::default()
        };
        for settings in [FlexxSettings::default(), ros] {
            settings.check().unwrap();
            let text = toml::to_string(&settings).unwrap();
            assert_eq!(parse(&text).unwrap(), settings, "{text}");
        }
        let manual = parse("[source]\nkind = \"royale\"\nexposure = { us = 500 }").unwrap();
        assert!(matches!(&manual.source, Source::Royale(r) if r.exposure == Exposure::Us(500)));
        let mixed =
            parse("frame_rate_hz = 30.0\n[source]\nkind = \"royale\"\nuse_case = \"MODE_MIXED_30_5\"")
                .unwrap();
        mixed.check().unwrap();
        assert_eq!(mixed.rate_hz(), 30.0);
    }

    #[test]
    fn an_address_is_a_camera_or_a_server() {
        let settings = FlexxSettings::default().with_address("ws://10.0.0.7:9090");
        assert!(matches!(&settings.source, Source::Rosbridge(r) if r.url == "ws://10.0.0.7:9090"));
        let back = settings.clone().with_address("0005-1203");
        assert!(matches!(&back.source, Source::Royale(r) if r.camera.as_deref() == Some("0005-1203")));
        assert_eq!(settings.clone().with_address(""), settings);
        settings.check().unwrap();
    }

    #[test]
    fn what_cannot_be_is_refused_by_name() {
        for (text, field) in [
            ("name = \"\"", "name"),
            ("size_px = [0, 172]", "size_px"),
            ("latency_ms = nan", "latency_ms"),
            ("max_noise_m = 0.0", "max_noise_m"),
            ("silence_ms = 100", "silence_ms"),
            ("retry_ms = 1", "retry_ms"),
            ("[source]\nkind = \"royale\"\nuse_case = \"MODE_MIXED_30_5\"", "source.use_case"),
            ("[source]\nkind = \"royale\"\nmin_confidence = 0", "source.min_confidence"),
            ("[source]\nkind = \"royale\"\ncamera = \"a\\u0000b\"", "source.camera"),
            ("[source]\nkind = \"royale\"\nexposure = { us = 0 }", "source.exposure.us"),
            ("[source]\nkind = \"rosbridge\"\nurl = \"wss://host\"", "source.url"),
            ("[source]\nkind = \"rosbridge\"\ntopic = \"points\"", "source.topic"),
        ] {
            assert_eq!(parse(text).unwrap().check().unwrap_err().field, field);
        }
        assert!(parse("[source]\nkind = \"usb\"").unwrap_err().contains("rosbridge"));
    }
}
