//! `visualization_msgs`, as of Humble and later.

use serde::{Deserialize, Serialize};

use super::{Duration, Header, Point, Pose, Vector3};

/// Values of [`Marker::kind`].
pub mod shape {
    /// Along x, by pose and scale.
    pub const ARROW: i32 = 0;
    /// A box of the scale's size.
    pub const CUBE: i32 = 1;
    /// An ellipsoid of the scale's diameters.
    pub const SPHERE: i32 = 2;
    /// Along z: diameters and height.
    pub const CYLINDER: i32 = 3;
    /// Spheres at points.
    pub const SPHERE_LIST: i32 = 7;
    /// A text that faces the viewer; the scale's z is the height of a capital.
    pub const TEXT_VIEW_FACING: i32 = 9;
    /// Three points for each triangle.
    pub const TRIANGLE_LIST: i32 = 11;
}

/// Values of [`Marker::action`].
pub mod action {
    /// Adds or changes.
    pub const ADD: i32 = 0;
    /// Deletes every marker of the topic.
    pub const DELETEALL: i32 = 3;
}

/// `std_msgs/ColorRGBA`, each 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct ColorRGBA {
    /// Red.
    pub r: f32,
    /// Green.
    pub g: f32,
    /// Blue.
    pub b: f32,
    /// Opacity.
    pub a: f32,
}

/// `sensor_msgs/CompressedImage`; empty here.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct CompressedImage {
    /// Header.
    pub header: Header,
    /// Format.
    pub format: String,
    /// A file.
    pub data: Vec<u8>,
}

/// `visualization_msgs/UVCoordinate`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct UVCoordinate {
    /// Along the texture's width.
    pub u: f32,
    /// Along its height.
    pub v: f32,
}

/// `visualization_msgs/MeshFile`; empty here.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct MeshFile {
    /// Its name.
    pub filename: String,
    /// Its contents.
    pub data: Vec<u8>,
}

/// `visualization_msgs/Marker`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Marker {
    /// Header.
    pub header: Header,
    /// Namespace: what viewers switch on and off.
    pub ns: String,
    /// Unique in its namespace.
    pub id: i32,
    /// One of [`shape`]; the field `type`.
    #[serde(rename = "type")]
    pub kind: i32,
    /// One of [`action`].
    pub action: i32,
    /// Pose in the header's frame.
    pub pose: Pose,
    /// Size, metres.
    pub scale: Vector3,
    /// Colour.
    pub color: ColorRGBA,
    /// 0 for ever.
    pub lifetime: Duration,
    /// Moves with its frame.
    pub frame_locked: bool,
    /// Of lists, in the marker's frame.
    pub points: Vec<Point>,
    /// Of points; empty here.
    pub colors: Vec<ColorRGBA>,
    /// Empty here.
    pub texture_resource: String,
    /// Empty here.
    pub texture: CompressedImage,
    /// Empty here.
    pub uv_coordinates: Vec<UVCoordinate>,
    /// Of a text.
    pub text: String,
    /// Empty here.
    pub mesh_resource: String,
    /// Empty here.
    pub mesh_file: MeshFile,
    /// Unused here.
    pub mesh_use_embedded_materials: bool,
}

/// `visualization_msgs/MarkerArray`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct MarkerArray {
    /// The markers.
    pub markers: Vec<Marker>,
}
