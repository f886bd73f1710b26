//! `PlannerService.ReadScene`: a scene as the planner reads it, without a search.

use graspd_proto::v1;

use crate::caller::Caller;
use crate::convert::{self, SceneContext};
use crate::deadline::CallClock;
use crate::engine::Engine;
use crate::error::ServiceError;
use crate::pool::Order;

/// Reads a scene, or gets the one that another call reads at the same time, and puts it into words; both on planning
/// threads.
pub(super) async fn read(
    engine: &Engine,
    clock: CallClock,
    caller: &Caller,
    request: v1::ReadSceneRequest,
) -> Result<v1::ReadSceneResponse, ServiceError> {
    let (scene, most_points) = convert::read_scene(request).map_err(ServiceError::from)?;
    let call = engine.call(clock, caller, scene)?;
    let _cancel = call.budget.cancel_on_drop();
    let ticket = engine.submit_scene(&call, &[])?;
    let read = engine.scene(&call, ticket).await?;
    let job_call = call.clone();
    let ticket = engine
        .pool
        .submit_continuation(&call.budget, &Order::brief(caller.flow), move |_| {
            let (asked, estimator) = job_call.asked();
            let frames = match most_points {
                0 => Vec::new(),
                _ => asked
                    .frames
                    .iter()
                    .map(|frame| Ok(frame.decode()?.0))
                    .collect::<Result<Vec<_>, ServiceError>>()?,
            };
            let (scene, stages) = read.parts();
            let context = SceneContext { world: asked.world_frame_id(), estimator, stages, most_points };
            Ok::<_, ServiceError>(convert::scene_response(scene, &frames, &context))
        })
        .map_err(|e| ServiceError::of_pool(&e, || clock.elapsed()))?;
    engine.finish(&call.budget, ticket).await.map_err(|e| ServiceError::of_pool(&e, || clock.elapsed()))?
}
