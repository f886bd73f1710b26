//! The gRPC services: thin translations between tonic and the engine.

mod hands;
mod info;
mod layer;
mod planner;
mod scene;
mod servo;

pub(crate) use hands::HandApi;
pub(crate) use info::InfoApi;
pub(crate) use layer::{CallLayer, Gatekeeper};
pub(crate) use planner::PlannerApi;
pub(crate) use servo::ServoApi;

use std::time::Instant;

use tonic::Extensions;

use crate::caller::Caller;
use crate::deadline::CallClock;
use crate::trace::TraceContext;

/// The clock that the layer put into the request.
fn clock(extensions: &Extensions) -> CallClock {
    extensions.get::<CallClock>().copied().unwrap_or(CallClock {
        arrived: Instant::now(),
        timeout: None,
        trace: TraceContext::default(),
    })
}

/// Who calls, as the layer found out.
fn caller(extensions: &Extensions) -> Caller {
    extensions.get::<Caller>().cloned().unwrap_or_else(|| Caller::named("unknown"))
}
