//! The graspd gRPC service: wire and domain conversion, planning pool, hand registry.
//!
//! A call passes, in this order: the service's layer (deadline, draining, log), `convert` (parse, don't
//! validate), the engine and its planning pool (CPU work never runs on the network runtime's threads), and
//! `convert` again on the way out. Errors are typed and become gRPC status in [`status`] alone.

pub mod calibration;
pub mod decode;
pub mod error;
pub mod estimators;
pub mod jobs;
pub mod pool;
pub mod registry;
pub mod security;
pub mod status;

mod answers;
mod call_record;
mod caller;
mod convert;
mod deadline;
mod engine;
mod estimates;
mod give_way;
mod health;
mod http;
mod live;
mod local;
mod metrics;
mod outgoing;
mod page;
mod picture;
mod random;
mod recorder;
mod scenes;
mod serve;
mod service;
mod servo;
mod trace;

pub use deadline::{CallBudget, CancelOnDrop};
pub use estimators::Estimators;
pub use graspd_live::LiveConfig;
pub use local::LocalEngine;
pub use page::{Example, Page};
pub use recorder::RecordConfig;
pub use registry::read_hand_dir;
pub use serve::{LoadProbe, ServeError, Server, ServerConfig, shutdown_signal};
