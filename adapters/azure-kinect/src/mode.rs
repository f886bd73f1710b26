//! Depth modes, frame rates and colour resolutions of the device, with their sizes in its data sheet.

use serde::{Deserialize, Serialize};

/// A depth mode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DepthMode {
    /// 320 x 288, narrow field of view, 2 x 2 pixels binned.
    Nfov2x2binned,
    /// 640 x 576, narrow field of view.
    NfovUnbinned,
    /// 512 x 512, wide field of view, 2 x 2 pixels binned.
    Wfov2x2binned,
    /// 1024 x 1024, wide field of view; at most 15 frames a second.
    WfovUnbinned,
}

impl DepthMode {
    /// All modes that measure depth.
    pub const ALL: [Self; 4] =
        [Self::Nfov2x2binned, Self::NfovUnbinned, Self::Wfov2x2binned, Self::WfovUnbinned];

    /// Width and height, pixels.
    pub fn size(self) -> (usize, usize) {
        match self {
            Self::Nfov2x2binned => (320, 288),
            Self::NfovUnbinned => (640, 576),
            Self::Wfov2x2binned => (512, 512),
            Self::WfovUnbinned => (1024, 1024),
        }
    }

    /// Size of the whole sensor in the mode's pixels, and what is cropped left and above.
    pub(crate) fn binning(self) -> ([f64; 2], [f64; 2]) {
        match self {
            Self::Nfov2x2binned => ([512.0; 2], [96.0, 90.0]),
            Self::NfovUnbinned => ([1024.0; 2], [192.0, 180.0]),
            Self::Wfov2x2binned => ([512.0; 2], [0.0; 2]),
            Self::WfovUnbinned => ([1024.0; 2], [0.0; 2]),
        }
    }

    /// Closest and farthest depth of the data sheet, metres.
    pub fn range_m(self) -> (f64, f64) {
        match self {
            Self::Nfov2x2binned => (0.5, 5.46),
            Self::NfovUnbinned => (0.5, 3.86),
            Self::Wfov2x2binned => (0.25, 2.88),
            Self::WfovUnbinned => (0.25, 2.21),
        }
    }

    /// As people say it.
    pub fn label(self) -> &'static str {
        match self {
            Self::Nfov2x2binned => "NFOV 2x2 binned",
            Self::NfovUnbinned => "NFOV unbinned",
            Self::Wfov2x2binned => "WFOV 2x2 binned",
            Self::WfovUnbinned => "WFOV unbinned",
        }
    }

    /// As recordings say it, in the tag `K4A_DEPTH_MODE`.
    pub fn tag(self) -> &'static str {
        match self {
            Self::Nfov2x2binned => "NFOV_2X2BINNED",
            Self::NfovUnbinned => "NFOV_UNBINNED",
            Self::Wfov2x2binned => "WFOV_2X2BINNED",
            Self::WfovUnbinned => "WFOV_UNBINNED",
        }
    }

    /// The mode of a tag.
    pub fn from_tag(tag: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|mode| mode.tag() == tag)
    }

    /// As the SDK's functions want it.
    pub(crate) fn code(self) -> i32 {
        match self {
            Self::Nfov2x2binned => 1,
            Self::NfovUnbinned => 2,
            Self::Wfov2x2binned => 3,
            Self::WfovUnbinned => 4,
        }
    }
}

/// Frames per second of a live device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "u32", into = "u32")]
pub enum FrameRate {
    /// 5.
    Five,
    /// 15.
    Fifteen,
    /// 30; not with [`DepthMode::WfovUnbinned`].
    Thirty,
}

impl FrameRate {
    /// Frames per second.
    pub fn hz(self) -> u32 {
        match self {
            Self::Five => 5,
            Self::Fifteen => 15,
            Self::Thirty => 30,
        }
    }

    /// As the SDK's functions want it.
    pub(crate) fn code(self) -> i32 {
        match self {
            Self::Five => 0,
            Self::Fifteen => 1,
            Self::Thirty => 2,
        }
    }
}

impl TryFrom<u32> for FrameRate {
    type Error = String;

    fn try_from(hz: u32) -> Result<Self, String> {
        let all = [Self::Five, Self::Fifteen, Self::Thirty];
        all.into_iter()
            .find(|rate| rate.hz() == hz)
            .ok_or_else(|| format!("frames per second: found {hz}, expected 5, 15 or 30"))
    }
}

impl From<FrameRate> for u32 {
    fn from(rate: FrameRate) -> Self {
        rate.hz()
    }
}

/// A resolution of the colour camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ColorResolution {
    /// 1280 x 720.
    P720,
    /// 1920 x 1080.
    P1080,
    /// 2560 x 1440.
    P1440,
    /// 2048 x 1536, 4 : 3.
    P1536,
    /// 3840 x 2160.
    P2160,
    /// 4096 x 3072, 4 : 3.
    P3072,
}

impl ColorResolution {
    /// Width and height, pixels.
    pub fn size(self) -> (usize, usize) {
        match self {
            Self::P720 => (1280, 720),
            Self::P1080 => (1920, 1080),
            Self::P1440 => (2560, 1440),
            Self::P1536 => (2048, 1536),
            Self::P2160 => (3840, 2160),
            Self::P3072 => (4096, 3072),
        }
    }

    /// As [`DepthMode::binning`]: the sensor is 4 : 3, modes of 16 : 9 are cut above and below.
    pub(crate) fn binning(self) -> ([f64; 2], [f64; 2]) {
        let (width, height) = self.size();
        let full = width as f64 * 0.75;
        ([width as f64, full], [0.0, (full - height as f64) / 2.0])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tags_and_settings_name_every_mode() {
        for mode in DepthMode::ALL {
            assert_eq!(DepthMode::from_tag(mode.tag()), Some(mode));
            let (binned, crop) = mode.binning();
            let (width, height) = mode.size();
            assert!(binned[0] >= width as f64 + crop[0] && binned[1] >= height as f64 + crop[1]);
        }
        assert_eq!(DepthMode::from_tag("PASSIVE_IR"), None);
        assert_eq!(serde_json::to_string(&DepthMode::Nfov2x2binned).unwrap(), "\"nfov2x2binned\"");
        assert_eq!(serde_json::from_str::<DepthMode>("\"nfov_unbinned\"").unwrap(), DepthMode::NfovUnbinned);
        assert!(serde_json::from_str::<FrameRate>("25").unwrap_err().to_string().contains("5, 15 or 30"));
    }

    #[test]
    fn wide_colour_modes_are_cut_above_and_below() {
        assert_eq!(ColorResolution::P720.binning(), ([1280.0, 960.0], [0.0, 120.0]));
        assert_eq!(ColorResolution::P2160.binning(), ([3840.0, 2880.0], [0.0, 360.0]));
        assert_eq!(ColorResolution::P3072.binning(), ([4096.0, 3072.0], [0.0, 0.0]));
    }
}
