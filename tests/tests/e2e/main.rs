//! End-to-end tests over real sockets, one module for each thing that a caller relies on.

// What tests share fails like a test.
#![allow(clippy::unwrap_used)]

mod bad_input;
mod cell;
mod deadlines;
mod frames;
mod hands;
mod lifecycle;
mod live;
mod page;
mod planning;
mod python;
mod recording;
mod rolling;
mod scheduling;
mod security;
mod servo;
mod streaming;
mod telemetry;

use graspd_client::{CallError, ClientError, PlanGraspsRequest, PlanOptions, SceneOptions};
use graspd_tests::BoxScene;

/// A plan for one hand in the box scene.
fn request(hand: &str) -> PlanGraspsRequest {
    PlanGraspsRequest {
        hand: format!("hands/{hand}"),
        frames: vec![BoxScene::default().frame()],
        options: Some(PlanOptions { seed: 1, ..PlanOptions::default() }),
        ..PlanGraspsRequest::default()
    }
}

/// The same with an estimator by name.
fn request_with(estimator: &str) -> PlanGraspsRequest {
    let scene_options = SceneOptions { estimator: estimator.to_owned(), ..SceneOptions::default() };
    PlanGraspsRequest { scene_options: Some(scene_options), ..request(GRIPPER) }
}

/// A two-finger gripper that is wide enough for the box.
const GRIPPER: &str = "robotiq-2f85";

/// The call's error.
fn call_error<T: std::fmt::Debug>(result: Result<T, ClientError>) -> CallError {
    match result {
        Err(ClientError::Call(error)) => error,
        other => panic!("expected the call to fail, found {other:?}"),
    }
}
