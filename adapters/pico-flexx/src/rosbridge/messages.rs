//! The messages that are read, as rosbridge writes them: fields of ROS 1 and ROS 2 differ in a few names.

use std::fmt;
use std::time::Duration;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde::de::{self, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};

/// What every message of the protocol has.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
pub struct Envelope {
    /// Operation: `publish`, `status`, ….
    pub op: String,
    /// Topic of what was published.
    #[serde(default)]
    pub topic: String,
    /// Level of a status: `error`, `warning`, `info`, `none`.
    #[serde(default)]
    pub level: String,
}

/// What was published, or told.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Published<T> {
    /// The message.
    pub msg: T,
}

/// A time since 1970.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(default)]
pub struct Stamp {
    #[serde(alias = "secs")]
    sec: i64,
    #[serde(alias = "nsecs", alias = "nsec")]
    nanosec: u32,
}

impl Stamp {
    /// As a duration; times before 1970 are 0.
    pub fn since_1970(self) -> Duration {
        Duration::from_secs(u64::try_from(self.sec).unwrap_or(0)) + Duration::from_nanos(self.nanosec.into())
    }
}

/// `std_msgs/Header`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Deserialize)]
#[serde(default)]
pub struct Header {
    /// Time of exposure.
    pub stamp: Stamp,
    /// Frame of reference.
    pub frame_id: String,
}

/// `sensor_msgs/Image`.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
pub struct Image {
    /// Header.
    #[serde(default)]
    pub header: Header,
    /// Height, pixels.
    pub height: u32,
    /// Width, pixels.
    pub width: u32,
    /// For example `32FC1`.
    pub encoding: String,
    /// Order of bytes.
    #[serde(default, deserialize_with = "truth")]
    pub is_bigendian: bool,
    /// Bytes of a row.
    pub step: u32,
    /// Rows.
    pub data: Bytes,
}

/// `sensor_msgs/PointField`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Deserialize)]
pub struct PointField {
    /// For example `z`.
    pub name: String,
    /// Bytes from the point's beginning.
    pub offset: u32,
    /// 7 for 32-bit floats.
    pub datatype: u8,
    /// Elements.
    #[serde(default)]
    pub count: u32,
}

/// `sensor_msgs/PointCloud2`.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
pub struct PointCloud2 {
    /// Header.
    #[serde(default)]
    pub header: Header,
    /// Height, points; 1 for a cloud that is not organized.
    pub height: u32,
    /// Width, points.
    pub width: u32,
    /// What a point has.
    pub fields: Vec<PointField>,
    /// Order of bytes.
    #[serde(default, deserialize_with = "truth")]
    pub is_bigendian: bool,
    /// Bytes of a point.
    pub point_step: u32,
    /// Bytes of a row.
    pub row_step: u32,
    /// Rows.
    pub data: Bytes,
}

/// `sensor_msgs/CameraInfo`.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
pub struct CameraInfo {
    /// Height, pixels.
    pub height: u32,
    /// Width, pixels.
    pub width: u32,
    /// `plumb_bob` or `rational_polynomial`.
    #[serde(default)]
    pub distortion_model: String,
    /// Distortion coefficients.
    #[serde(default, alias = "D")]
    pub d: Vec<f64>,
    /// Camera matrix, row major.
    #[serde(alias = "K")]
    pub k: [f64; 9],
}

/// `uint8[]`: base64 text, or a list of numbers.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Bytes(pub Vec<u8>);

impl<'de> Deserialize<'de> for Bytes {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Either;

        impl<'de> Visitor<'de> for Either {
            type Value = Bytes;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("base64 text or a list of bytes")
            }

            fn visit_str<E: de::Error>(self, text: &str) -> Result<Bytes, E> {
                STANDARD.decode(text).map(Bytes).map_err(E::custom)
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Bytes, A::Error> {
                let mut bytes = Vec::new();
                while let Some(byte) = list.next_element()? {
                    bytes.push(byte);
                }
                Ok(Bytes(bytes))
            }
        }

        deserializer.deserialize_any(Either)
    }
}

/// A `bool`, or a `uint8` that means one.
fn truth<'de, D: Deserializer<'de>>(deserializer: D) -> Result<bool, D::Error> {
    struct Either;

    impl Visitor<'_> for Either {
        type Value = bool;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("true, false, 1 or 0")
        }

        fn visit_bool<E: de::Error>(self, value: bool) -> Result<bool, E> {
            Ok(value)
        }

        fn visit_u64<E: de::Error>(self, value: u64) -> Result<bool, E> {
            Ok(value != 0)
        }
    }

    deserializer.deserialize_any(Either)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn both_generations_of_ros_are_read() {
        let ros1 = r#"{"op":"publish","topic":"/a","msg":{"header":{"seq":4,"stamp":{"secs":12,"nsecs":5},"frame_id":"f"},
            "height":1,"width":2,"encoding":"16UC1","is_bigendian":0,"step":4,"data":"6APQBw=="}}"#;
        let ros2 = r#"{"op":"publish","topic":"/a","msg":{"header":{"stamp":{"sec":12,"nanosec":5},"frame_id":"f"},
            "height":1,"width":2,"encoding":"16UC1","is_bigendian":false,"step":4,"data":[232,3,208,7]}}"#;
        let read = |text: &str| serde_json::from_str::<Published<Image>>(text).unwrap().msg;
        assert_eq!(read(ros1), read(ros2));
        assert_eq!(read(ros1).header.stamp.since_1970(), Duration::new(12, 5));
        let envelope: Envelope = serde_json::from_str(ros1).unwrap();
        assert_eq!((envelope.op.as_str(), envelope.topic.as_str()), ("publish", "/a"));
        let lower = r#"{"msg":{"height":1,"width":1,"distortion_model":"plumb_bob","d":[1],"k":[1,0,2,0,3,4,0,0,1]}}"#;
        let upper = lower.replace("\"d\"", "\"D\"").replace("\"k\"", "\"K\"");
        let read = |text: &str| serde_json::from_str::<Published<CameraInfo>>(text).unwrap().msg;
        assert_eq!(read(lower), read(&upper));
    }

    #[test]
    fn times_before_1970_and_odd_nanoseconds_are_no_harm() {
        let stamp: Stamp = serde_json::from_str(r#"{"sec":-4,"nanosec":4294967295}"#).unwrap();
        assert_eq!(stamp.since_1970(), Duration::from_nanos(4_294_967_295));
    }

    proptest! {
        #[test]
        fn arbitrary_texts_end_without_panic(text in "\\PC{0,200}", data in "\\PC{0,40}") {
            let _envelope = serde_json::from_str::<Envelope>(&text);
            let message = serde_json::json!({"msg": {
                "height": 1, "width": 1, "encoding": text, "step": 1, "data": data, "fields": [], "point_step": 1, "row_step": 1,
            }});
            let message = message.to_string();
            let _image = serde_json::from_str::<Published<Image>>(&message);
            let _cloud = serde_json::from_str::<Published<PointCloud2>>(&message);
        }
    }
}
