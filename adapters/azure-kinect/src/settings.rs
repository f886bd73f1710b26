//! Settings of the camera, as a table that a configuration file can hold.
//!
//! ```toml
//! [camera.settings.azure-kinect]
//! name = "kinect"
//!
//! [camera.settings.azure-kinect.source]
//! kind = "device"               # or "recording"
//! mode = "nfov_unbinned"
//! frames_per_second = 30
//! ```

use std::path::{Path, PathBuf};
use std::time::Duration;

use graspd_adapters_core::check::{SettingsError, require};
use serde::{Deserialize, Serialize};

use crate::mode::{DepthMode, FrameRate};

/// Settings of the adapter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KinectSettings {
    /// Name for logs and errors.
    pub name: String,
    /// Where frames come from.
    pub source: Source,
}

impl Default for KinectSettings {
    fn default() -> Self {
        Self { name: "azure-kinect".into(), source: Source::Device(DeviceSettings::default()) }
    }
}

/// Where frames come from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Source {
    /// A live device, through the manufacturer's library.
    Device(DeviceSettings),
    /// A recording.
    Recording(RecordingSettings),
}

/// A live device.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DeviceSettings {
    /// Serial number; left out: the first device.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub serial: Option<String>,
    /// The library `libk4a.so`, or its folder; left out: `K4A_LIB` of the environment, then the system's places.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub library: Option<PathBuf>,
    /// Depth mode.
    pub mode: DepthMode,
    /// 5, 15 or 30; with `wfov_unbinned` at most 15.
    pub frames_per_second: FrameRate,
    /// The white light on the front stays off.
    pub dark: bool,
    /// What a frame needs at least from exposure to arrival, milliseconds; left out: a frame's duration, which no measurement
    /// on a device supports.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub latency_ms: Option<f64>,
    /// Without a frame for so long, milliseconds, a streaming device counts as lost.
    pub silence_ms: u64,
    /// Pause before a lost device is looked for again, milliseconds; it doubles up to 16 times this.
    pub retry_ms: u64,
}

impl Default for DeviceSettings {
    fn default() -> Self {
        Self {
            serial: None,
            library: None,
            mode: DepthMode::NfovUnbinned,
            frames_per_second: FrameRate::Thirty,
            dark: false,
            latency_ms: None,
            silence_ms: 3000,
            retry_ms: 500,
        }
    }
}

impl DeviceSettings {
    pub(crate) fn latency(&self) -> Duration {
        let period_ms = 1e3 / f64::from(self.frames_per_second.hz());
        Duration::from_secs_f64(self.latency_ms.unwrap_or(period_ms) * 1e-3)
    }
}

/// How fast a recording is played.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pace {
    /// As it was recorded: frames that nobody asks for in time are gone.
    RealTime,
    /// Each call gets the next frame, as fast as calls come: no frame is left out, save the answer of a call given up.
    AsAsked,
}

/// A recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecordingSettings {
    /// The file, `.mkv` of `k4arecorder`.
    pub path: PathBuf,
    /// How fast.
    pub pace: Pace,
    /// Begin again at the end; else calls after the last frame fail.
    pub repeat: bool,
}

impl Default for RecordingSettings {
    fn default() -> Self {
        Self { path: PathBuf::new(), pace: Pace::RealTime, repeat: false }
    }
}

impl KinectSettings {
    /// A recording with this name and pace.
    pub fn recording(path: impl Into<PathBuf>, pace: Pace, repeat: bool) -> Self {
        let source = Source::Recording(RecordingSettings { path: path.into(), pace, repeat });
        Self { source, ..Self::default() }
    }

    /// The same camera at an address: a recording for a file that ends in `.mkv`, else the device of this serial number. What
    /// the settings say of that kind of source stays; an empty address changes nothing.
    pub fn with_address(mut self, address: &str) -> Self {
        if address.is_empty() {
            return self;
        }
        let is_file = Path::new(address).extension().is_some_and(|e| e.eq_ignore_ascii_case("mkv"));
        self.source = match (self.source, is_file) {
            (Source::Recording(source), true) => {
                Source::Recording(RecordingSettings { path: address.into(), ..source })
            }
            (_, true) => {
                Source::Recording(RecordingSettings { path: address.into(), ..RecordingSettings::default() })
            }
            (Source::Device(source), false) => {
                Source::Device(DeviceSettings { serial: Some(address.to_owned()), ..source })
            }
            (_, false) => Source::Device(DeviceSettings {
                serial: Some(address.to_owned()),
                ..DeviceSettings::default()
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
        match &self.source {
            Source::Recording(recording) => {
                let found = recording.path.display().to_string();
                require("source.path", found, !recording.path.as_os_str().is_empty(), "a file")
            }
            Source::Device(device) => {
                let slow_enough =
                    device.mode != DepthMode::WfovUnbinned || device.frames_per_second != FrameRate::Thirty;
                let hz = device.frames_per_second.hz();
                require("source.frames_per_second", hz, slow_enough, "5 or 15 in mode wfov_unbinned")?;
                if let Some(ms) = device.latency_ms {
                    require("source.latency_ms", ms, (0.0..=1000.0).contains(&ms), "0 to 1000")?;
                }
                let (silence, retry) = (device.silence_ms, device.retry_ms);
                let fastest = u64::from(3000 / hz);
                let patient = (fastest..=60_000).contains(&silence);
                let expected = format!("{fastest} (three frames) to 60000");
                require("source.silence_ms", silence, patient, expected)?;
                require("source.retry_ms", retry, (10..=60_000).contains(&retry), "10 to 60000")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_survive_a_file() {
        KinectSettings::default().check().unwrap();
        for settings in
            [KinectSettings::default(), KinectSettings::recording("/tmp/a.mkv", Pace::AsAsked, true)]
        {
            let text = toml::to_string(&settings).unwrap();
            assert_eq!(toml::from_str::<KinectSettings>(&text).unwrap(), settings, "{text}");
        }
        let short: KinectSettings = toml::from_str("[source]\nkind = \"device\"\nserial = \"0001\"").unwrap();
        assert!(
            matches!(&short.source, Source::Device(d) if d.serial.as_deref() == Some("0001") && d.silence_ms == 3000)
        );
    }

    #[test]
    fn an_address_is_a_serial_number_or_a_recording() {
        let slow = DeviceSettings { frames_per_second: FrameRate::Five, ..DeviceSettings::default() };
        let slow = KinectSettings { source: Source::Device(slow), ..KinectSettings::default() };
        let Source::Device(device) = slow.clone().with_address("000123").source else { panic!("no device") };
        assert_eq!((device.serial.as_deref(), device.frames_per_second), (Some("000123"), FrameRate::Five));
        let file = slow.clone().with_address("/data/a.MKV");
        assert!(matches!(&file.source, Source::Recording(r) if r.path == Path::new("/data/a.MKV")));
        assert_eq!(slow.clone().with_address(""), slow);
        let repeated = KinectSettings::recording("a.mkv", Pace::AsAsked, true).with_address("b.mkv");
        assert_eq!(repeated, KinectSettings::recording("b.mkv", Pace::AsAsked, true));
        assert!(
            matches!(repeated.with_address("7").source, Source::Device(d) if d.serial.as_deref() == Some("7"))
        );
    }

    #[test]
    fn what_cannot_be_is_refused_by_name() {
        let parse = |text: &str| toml::from_str::<KinectSettings>(text).map_err(|e| e.to_string());
        for (text, expected) in [
            ("[source]\nkind = \"device\"\nframes_per_second = 25", "5, 15 or 30"),
            ("[source]\nkind = \"device\"\nmode = \"huge\"", "nfov_unbinned"),
            ("[source]\nkind = \"device\"\nspeed = 1", "speed"),
            ("[source]\nkind = \"webcam\"", "recording"),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
        for (text, field) in [
            ("[source]\nkind = \"recording\"", "source.path"),
            ("[source]\nkind = \"device\"\nmode = \"wfov_unbinned\"", "source.frames_per_second"),
            ("[source]\nkind = \"device\"\nlatency_ms = nan", "source.latency_ms"),
            ("[source]\nkind = \"device\"\nsilence_ms = 10", "source.silence_ms"),
            ("[source]\nkind = \"device\"\nretry_ms = 0", "source.retry_ms"),
            ("name = \"\"", "name"),
        ] {
            assert_eq!(parse(text).unwrap().check().unwrap_err().field, field);
        }
    }
}
