//! Recordings: what is recorded, that it can be planned again, and what becomes of reports.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use graspd_client::{
    Code, GraspEvent, GraspOutcome, HandTask, PlanGraspsRequest, PlanMultiHandRequest, PlanOptions,
    ReportOutcomeRequest,
};
use graspd_proto::v1::hand_task_result::Outcome;
use graspd_proto::v1::plan_record::Request;
use graspd_proto::v1::{PlanGraspsResponse, PlanRecord};
use graspd_recording::Recording;
use graspd_server::calibration::Calibration;
use graspd_server::{RecordConfig, ServerConfig};
use graspd_tests::{BoxScene, TestServer};

use crate::{GRIPPER, call_error, request, request_with};

/// A folder of its own; removed at its end.
pub(crate) struct Scratch(pub(crate) PathBuf);

impl Scratch {
    pub(crate) fn new() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let n = COUNT.fetch_add(1, Ordering::Relaxed);
        Self(Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("recording-{}-{n}", std::process::id())))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.0).ok();
    }
}

pub(crate) fn config(folder: &Path, share: f64) -> ServerConfig {
    let record = RecordConfig { folder: folder.to_owned(), share, budget_bytes: 64 << 20 };
    ServerConfig { record: Some(record), ..TestServer::config() }
}

pub(crate) async fn stop(server: TestServer) {
    server.stop().await.unwrap().unwrap();
}

fn read(folder: &Path) -> Recording {
    let mut all = Recording { ended: true, ..Recording::default() };
    for file in graspd_recording::files(folder).unwrap() {
        let Recording { plans, outcomes, ended } = graspd_recording::read_file(&file).unwrap();
        all.plans.extend(plans);
        all.outcomes.extend(outcomes);
        all.ended &= ended;
    }
    all
}

fn answer(record: &PlanRecord, task: usize) -> &PlanGraspsResponse {
    match &record.results[task].outcome {
        Some(Outcome::Response(answer)) => answer,
        other => panic!("expected an answer, found {other:?}"),
    }
}

/// One call of each kind: three calls, four answers.
pub(crate) async fn call_all(server: &TestServer) -> Vec<PlanGraspsResponse> {
    let client = server.client().await;
    let mut answers = vec![client.plan_grasps(&request(GRIPPER)).await.unwrap()];
    // 16-bit pixels, without a pose.
    let bare =
        PlanGraspsRequest { frames: vec![BoxScene::default().frame_without_pose()], ..request("leap") };
    let mut stream = client.stream_grasps(&bare).await.unwrap();
    while let Some(event) = stream.next().await.unwrap() {
        if let GraspEvent::Finished(answer) = event {
            answers.push(answer);
        }
    }
    let task = |id: &str, hand: &str| HandTask {
        task_id: id.to_owned(),
        hand: format!("hands/{hand}"),
        options: Some(PlanOptions { seed: 5, ..PlanOptions::default() }),
    };
    let several = PlanMultiHandRequest {
        frames: vec![BoxScene::default().frame()],
        tasks: vec![task("left arm", GRIPPER), task("right", "allegro")],
        ..PlanMultiHandRequest::default()
    };
    let mut stream = client.plan_multi_hand(&several).await.unwrap();
    while let Some(event) = stream.next().await.unwrap() {
        if let graspd_client::MultiHandEvent::Result(result) = event
            && let Some(Outcome::Response(answer)) = result.outcome
        {
            answers.push(answer);
        }
    }
    assert_eq!(answers.len(), 4);
    answers
}

#[tokio::test]
async fn every_kind_of_call_is_recorded_and_plans_again_bit_for_bit() {
    let scratch = Scratch::new();
    let server = TestServer::start_with(config(&scratch.0, 1.0)).await;
    let answers = call_all(&server).await;
    assert!(answers.iter().all(|a| a.recorded));
    let mut ids: Vec<_> = answers.iter().map(|a| a.plan_id.clone()).collect();
    ids.sort();
    ids.dedup();
    assert_eq!(ids.len(), 4);
    // A call that fails while it plans is there as well, one that was refused is not.
    let client = server.client().await;
    assert_eq!(
        call_error(client.plan_grasps(&request_with(graspd_tests::PANICS)).await).code,
        Code::Internal
    );
    assert_eq!(call_error(client.plan_grasps(&request("nobody")).await).code, Code::NotFound);
    stop(server).await;

    let recording = read(&scratch.0);
    assert!(recording.ended && recording.outcomes.is_empty());
    assert_eq!(recording.plans.len(), 4);
    let Some(Request::PlanGrasps(first)) = &recording.plans[0].request else { panic!("no request") };
    assert_eq!(*first, request(GRIPPER), "everything that was sent, pixels included");
    assert_eq!(*answer(&recording.plans[0], 0), answers[0]);
    assert_eq!(*answer(&recording.plans[1], 0), answers[1]);
    assert!(recording.plans[2].results.len() == 2 && recording.plans[2].total_duration.is_some());
    assert!(
        matches!(&recording.plans[3].results[0].outcome, Some(Outcome::Error(e)) if e.reason == "JOB_PANICKED")
    );

    let again = TestServer::start().await;
    let client = again.client().await;
    for record in &recording.plans[..2] {
        let Some(Request::PlanGrasps(request)) = &record.request else { panic!("no request") };
        let planned = client.plan_grasps(request).await.unwrap();
        assert!(!planned.grasps.is_empty());
        assert_eq!(planned.grasps, answer(record, 0).grasps);
        assert!(!planned.recorded);
    }
}

#[tokio::test]
async fn calls_are_recorded_by_their_share_or_when_they_ask_for_it() {
    let scratch = Scratch::new();
    let server = TestServer::start_with(config(&scratch.0, 0.0)).await;
    let client = server.client().await;
    let plain = client.plan_grasps(&request(GRIPPER)).await.unwrap();
    assert!(!plain.recorded && !plain.plan_id.is_empty());
    let asked = PlanGraspsRequest { record: true, request_id: "once".to_owned(), ..request(GRIPPER) };
    let recorded = client.plan_grasps(&asked).await.unwrap();
    assert!(recorded.recorded);
    // The same call again is not another one.
    assert_eq!(client.plan_grasps(&asked).await.unwrap(), recorded);
    stop(server).await;
    let recording = read(&scratch.0);
    assert_eq!(recording.plans.len(), 1);
    assert_eq!(answer(&recording.plans[0], 0).plan_id, recorded.plan_id);
}

fn report(plan_id: &str, grasp_index: i32, outcome: GraspOutcome, note: &str) -> ReportOutcomeRequest {
    ReportOutcomeRequest {
        plan_id: plan_id.to_owned(),
        grasp_index,
        outcome: outcome.into(),
        note: note.to_owned(),
    }
}

#[tokio::test]
async fn outcomes_are_kept_with_their_plans_over_a_restart_too() {
    let scratch = Scratch::new();
    let server = TestServer::start_with(config(&scratch.0, 1.0)).await;
    let client = server.client().await;
    let plan = client.plan_grasps(&request(GRIPPER)).await.unwrap();
    let failed = report(&plan.plan_id, 0, GraspOutcome::LostLifting, "it slipped");
    assert!(!client.report_outcome(&failed).await.unwrap().repeated_report);
    assert!(client.report_outcome(&failed).await.unwrap().repeated_report);
    stop(server).await;
    assert_eq!(read(&scratch.0).outcomes.len(), 1, "a repetition is not written");

    let server = TestServer::start_with(config(&scratch.0, 1.0)).await;
    let client = server.client().await;
    // Known from its file.
    let better = report(&plan.plan_id, 1, GraspOutcome::Success, "");
    client.report_outcome(&better).await.unwrap();
    let recording = read(&scratch.0);
    assert_eq!(recording.outcomes.len(), 2, "written when it is answered");
    let kept = &recording.outcomes[1];
    assert_eq!(kept.report.as_ref(), Some(&better));
    assert_eq!(kept.hand, format!("hands/{GRIPPER}"));
    assert_eq!(kept.uncalibrated_score, plan.grasps[1].uncalibrated_score);

    let refused = async |report: &ReportOutcomeRequest| call_error(client.report_outcome(report).await);
    let never = "019ab2c4-73b1-7c10-9f26-3d2f0a61d9f0";
    for id in [never, "x", &"9".repeat(5000)] {
        let error = refused(&report(id, 0, GraspOutcome::Success, "")).await;
        assert_eq!((error.code, error.reason.as_str()), (Code::NotFound, "PLAN_NOT_FOUND"), "{id}");
    }
    let count = i32::try_from(plan.grasps.len()).unwrap();
    for (wrong, field) in [
        (report(&plan.plan_id, count, GraspOutcome::Success, ""), "grasp_index"),
        (report(&plan.plan_id, -1, GraspOutcome::Success, ""), "grasp_index"),
        (report(&plan.plan_id, 0, GraspOutcome::Unspecified, ""), "outcome"),
        (report("", 0, GraspOutcome::Success, ""), "plan_id"),
        (report(&plan.plan_id, 0, GraspOutcome::Success, &"x".repeat(1025)), "note"),
    ] {
        let error = refused(&wrong).await;
        assert_eq!((error.code, error.violations[0].field.as_str()), (Code::InvalidArgument, field));
    }
    let elsewhere = TestServer::start().await;
    let error = call_error(elsewhere.client().await.report_outcome(&better).await);
    assert_eq!((error.code, error.reason.as_str()), (Code::FailedPrecondition, "NO_RECORDING"));
}

#[tokio::test]
async fn a_calibration_makes_scores_shares_and_keeps_their_order() {
    let knots = vec![(0.0, 0.05), (0.4, 0.1), (1.0, 0.7)];
    let site = Calibration::new("bench 3", (120, 60), 1_800_000_000, knots).unwrap();
    let plain = TestServer::start().await;
    let calibrated =
        TestServer::start_with(ServerConfig { calibration: Some(site.clone()), ..TestServer::config() })
            .await;
    let before = plain.client().await.plan_grasps(&request(GRIPPER)).await.unwrap();
    let client = calibrated.client().await;
    let after = client.plan_grasps(&request(GRIPPER)).await.unwrap();
    assert_eq!(before.calibration, None);
    assert!(before.grasps.iter().all(|g| g.score == g.uncalibrated_score));
    let said = after.calibration.unwrap();
    assert_eq!((said.name.as_str(), said.outcome_count), ("bench 3", 120));
    assert!(after.grasps.len() > 1 && after.grasps.len() == before.grasps.len());
    for (a, b) in after.grasps.iter().zip(&before.grasps) {
        assert_eq!((a.uncalibrated_score, &a.wrist_pose), (b.score, &b.wrist_pose));
        assert_eq!(a.score, site.share(b.score));
    }
    assert!(after.grasps.is_sorted_by(|a, b| a.score >= b.score));
    // A least score is one of the scores that the caller sees.
    let least = (after.grasps[0].score + after.grasps[1].score) / 2.0;
    if after.grasps[0].score > after.grasps[1].score {
        let options = PlanOptions { seed: 1, min_score: Some(least), ..PlanOptions::default() };
        let plan = PlanGraspsRequest { options: Some(options), ..request(GRIPPER) };
        let fewer = client.plan_grasps(&plan).await.unwrap();
        assert_eq!(fewer.grasps.len(), 1);
        assert_eq!(fewer.grasps[0], after.grasps[0]);
    }
}
