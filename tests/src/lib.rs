//! What the end-to-end tests share: a server in this process on a free port, and a depth frame of a known
//! scene.

mod estimators;
mod scene;
mod server;

pub use estimators::{PANICS, Panics, STALLS};
pub use scene::{BOX_HALF_M, BoxScene, SCENE_FRAME};
pub use server::TestServer;
