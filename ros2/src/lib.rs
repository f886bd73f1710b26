//! graspd for ROS 2: depth images and goals in, grasps and markers out.
//!
//! [`node`] speaks DDS, [`bridge`] decides, [`link`] keeps the connection to a graspd server, and everything else is pure: messages to
//! a frame of the protocol ([`depth`], [`pairing`]), a goal to a request ([`goal`]), an answer to messages ([`answer`], [`markers`],
//! [`status`]). No ROS installation is needed, to build or to run.

pub mod answer;
pub mod bridge;
pub mod call;
pub mod depth;
pub mod goal;
pub mod hand;
pub mod link;
pub mod markers;
pub mod messages;
pub mod names;
pub mod node;
pub mod pairing;
pub mod poses;
pub mod settings;
pub mod status;
