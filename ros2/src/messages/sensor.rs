//! `sensor_msgs`.

use serde::{Deserialize, Serialize};

use super::{Header, octets};

/// `sensor_msgs/Image`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Image {
    /// Optical frame (x right, y down, z forward) and time of exposure.
    pub header: Header,
    /// Rows.
    pub height: u32,
    /// Columns.
    pub width: u32,
    /// For example `16UC1`.
    pub encoding: String,
    /// Not 0: the first byte of a number is its most significant.
    pub is_bigendian: u8,
    /// Bytes from one row to the next.
    pub step: u32,
    /// `step * height` bytes.
    #[serde(with = "octets")]
    pub data: Vec<u8>,
}

/// `sensor_msgs/RegionOfInterest`; all 0 is the whole image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct RegionOfInterest {
    /// First column, pixels without binning.
    pub x_offset: u32,
    /// First row, pixels without binning.
    pub y_offset: u32,
    /// Rows, pixels without binning.
    pub height: u32,
    /// Columns, pixels without binning.
    pub width: u32,
    /// The region of a rectified image is smaller.
    pub do_rectify: bool,
}

/// `sensor_msgs/CameraInfo`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct CameraInfo {
    /// As the image's.
    pub header: Header,
    /// Rows that the calibration is for.
    pub height: u32,
    /// Columns that the calibration is for.
    pub width: u32,
    /// For example `plumb_bob`.
    pub distortion_model: String,
    /// Coefficients of distortion.
    pub d: Vec<f64>,
    /// Matrix of the raw image, row major; all 0 without calibration.
    pub k: [f64; 9],
    /// Rectification.
    pub r: [f64; 9],
    /// Projection of the rectified image, 3 × 4, row major.
    pub p: [f64; 12],
    /// Columns that are one in the image; 0 is 1.
    pub binning_x: u32,
    /// Rows that are one in the image; 0 is 1.
    pub binning_y: u32,
    /// The part of the sensor that the image shows.
    pub roi: RegionOfInterest,
}

/// `sensor_msgs/JointState`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct JointState {
    /// Header.
    pub header: Header,
    /// Joints by name.
    pub name: Vec<String>,
    /// Radians or metres.
    pub position: Vec<f64>,
    /// Left empty here.
    pub velocity: Vec<f64>,
    /// Left empty here.
    pub effort: Vec<f64>,
}
