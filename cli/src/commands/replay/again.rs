//! A recorded call, planned again.

use std::collections::BTreeMap;
use std::time::Duration;

use graspd_client::{Client, ClientError, MultiHandEvent};
use graspd_planner::options::Scheme;
use graspd_proto::v1;
use graspd_proto::v1::hand_task_result::Outcome;
use graspd_proto::v1::plan_record::Request;

use super::compare::Task;

/// No search of a recording takes longer.
const PATIENCE: Duration = Duration::from_secs(600);

/// Plans a call again; one entry for each of its tasks that had an answer.
///
/// # Errors
/// When the server is gone. What it says of the request is an entry.
pub(super) async fn plan(
    client: &Client,
    index: usize,
    record: &v1::PlanRecord,
) -> anyhow::Result<Vec<Task>> {
    let client = client.with_timeout(PATIENCE);
    let answers: BTreeMap<String, Outcome> = match &record.request {
        None => BTreeMap::new(),
        Some(Request::PlanGrasps(plan)) => {
            let recorded = record.results.first();
            let request = v1::PlanGraspsRequest {
                scene_options: scene(plan.scene_options.clone(), recorded),
                options: search(plan.options.clone(), recorded),
                request_id: String::new(),
                record: false,
                ..plan.clone()
            };
            let answer = client.plan_grasps(&request).await.map(Outcome::Response).or_else(refused)?;
            BTreeMap::from([(String::new(), answer)])
        }
        Some(Request::PlanMultiHand(plan)) => {
            let recorded = |id: &str| record.results.iter().find(|result| result.task_id == id);
            let tasks = plan.tasks.iter().map(|task| v1::HandTask {
                options: search(task.options.clone(), recorded(&task.task_id)),
                ..task.clone()
            });
            let request = v1::PlanMultiHandRequest {
                tasks: tasks.collect(),
                scene_options: scene(plan.scene_options.clone(), record.results.first()),
                request_id: String::new(),
                record: false,
                ..plan.clone()
            };
            multi_hand(&client, &request).await?
        }
    };
    let compare = |result: &v1::HandTaskResult| {
        let recorded = result.outcome.as_ref()?;
        Some(Task::new(index, record, &result.task_id, recorded, answers.get(&result.task_id)))
    };
    Ok(record.results.iter().filter_map(compare).collect())
}

async fn multi_hand(
    client: &Client,
    request: &v1::PlanMultiHandRequest,
) -> anyhow::Result<BTreeMap<String, Outcome>> {
    let all = |error: Outcome| request.tasks.iter().map(|t| (t.task_id.clone(), error.clone())).collect();
    let mut stream = match client.plan_multi_hand(request).await {
        Ok(stream) => stream,
        Err(error) => return Ok(all(refused(error)?)),
    };
    let mut answers = BTreeMap::new();
    loop {
        match stream.next().await {
            Ok(Some(MultiHandEvent::Result(result))) => {
                if let Some(outcome) = result.outcome {
                    answers.insert(result.task_id, outcome);
                }
            }
            Ok(Some(_)) => {}
            Ok(None) => return Ok(answers),
            Err(error) => return Ok(all(refused(error)?)),
        }
    }
}

/// What a server says of a request that it does not plan; a server that is not there is an error.
fn refused(error: ClientError) -> anyhow::Result<Outcome> {
    match error {
        ClientError::Call(call) if call.code != graspd_client::Code::Unavailable => {
            Ok(Outcome::Error(v1::TaskError {
                code: call.code as i32,
                message: call.message,
                reason: call.reason,
                field_violations: Vec::new(),
            }))
        }
        other => Err(other.into()),
    }
}

fn stats(recorded: Option<&v1::HandTaskResult>) -> Option<&v1::PlanStats> {
    match recorded?.outcome.as_ref()? {
        Outcome::Response(answer) => answer.stats.as_ref(),
        Outcome::Error(_) => None,
    }
}

/// By the estimator that was the default then.
fn scene(
    options: Option<v1::SceneOptions>,
    recorded: Option<&v1::HandTaskResult>,
) -> Option<v1::SceneOptions> {
    let mut options = options.unwrap_or_default();
    if let Some(stats) = stats(recorded)
        && options.estimator.is_empty()
    {
        options.estimator.clone_from(&stats.estimator);
    }
    Some(options)
}

/// With the scheme that the deadline had picked, and all the time that it needs.
fn search(
    options: Option<v1::PlanOptions>,
    recorded: Option<&v1::HandTaskResult>,
) -> Option<v1::PlanOptions> {
    let mut options = options.unwrap_or_default();
    options.budget = None;
    if let (None, Some(stats)) = (&options.scheme, stats(recorded)) {
        let known = [Scheme::THOROUGH, Scheme::BALANCED, Scheme::QUICK];
        let picked = known.iter().find(|s| i32::try_from(s.iterations) == Ok(stats.iteration_count));
        let picked = picked.copied().unwrap_or_default();
        options.scheme = Some(v1::Scheme {
            iteration_count: i32::try_from(picked.iterations).unwrap_or(i32::MAX),
            penetration_iteration_count: i32::try_from(picked.with_penetration).unwrap_or(i32::MAX),
        });
    }
    Some(options)
}
