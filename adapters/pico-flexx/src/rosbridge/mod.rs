//! A ROS driver as a source of frames, over the WebSocket protocol of rosbridge (version 2): text in JSON, bytes in base64.
//!
//! - [`messages`]: the messages that are read, of ROS 1 and ROS 2 alike.
//! - [`depth`]: depth from the bytes of an image or a point cloud.
//! - `bridge`: the connection, on a thread of its own.

mod bridge;
pub mod depth;
pub mod messages;

pub(crate) use bridge::Bridge;
