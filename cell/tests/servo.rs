//! The servo task with scripted devices: the hand follows what every frame refines, and every trouble on the way has an end.

// What tests share fails like a test.
#[allow(clippy::unwrap_used)]
#[allow(dead_code)] // other tests use the rest
mod scripted;

use graspd_cell::config::{CellConfig, ServoConfig};
use graspd_cell::outcome::{End, Holding};
use graspd_cell::steps::Step;
use scripted::{Fault, Shared, config, run};

fn servo() -> CellConfig {
    CellConfig { servo: Some(ServoConfig::default()), ..config() }
}

fn shared(objects: u32) -> Shared {
    let shared = Shared::new(objects);
    shared.world().palm_camera = true;
    shared
}

#[tokio::test(start_paused = true)]
async fn every_grasp_is_followed_and_gripped_where_the_last_answer_said() {
    let shared = shared(3);
    let (report, log) = run(&shared, &servo()).await;
    assert_eq!((report.end, report.holding), (End::Empty, Holding::Nothing));
    assert_eq!((report.tally.trials, report.tally.successes, log), (3, 3, vec![]));
    let world = shared.world();
    assert_eq!((world.delivered, world.streams), (3, 5), "a stream for each attempt, two for the empty tray");
    assert_eq!(world.calls.get("plan"), None, "the servo plans");
    // It looks from where the configuration says, before anything is planned.
    let eye = ServoConfig::default().eye_m;
    let looked =
        |at: &nalgebra::Isometry3<f64>| (at.translation.vector - nalgebra::Vector3::from(eye)).norm() < 1e-9;
    assert!(world.moves.iter().any(|(step, at)| *step == Step::ClearView && looked(at)));
    let of = |wanted: Step| world.moves.iter().filter(move |(step, _)| *step == wanted);
    // Ever nearer: each pose that was followed is lower than the one before. The first answer has planned; the last lets the
    // hand go in from where it stands.
    let followed: Vec<f64> = of(Step::Follow).map(|(_, at)| at.translation.vector.z).take(5).collect();
    assert!(followed.len() == 5 && followed.windows(2).all(|w| w[1] < w[0]), "{followed:?}");
    // Seven answers, a millimetre each: what is gripped is the last of them.
    assert!(of(Step::Approach).all(|(_, at)| (at.translation.vector.x - 0.007).abs() < 1e-9));
}

#[tokio::test(start_paused = true)]
async fn one_trouble_while_following_costs_no_object() {
    for (fault, expected) in [
        (Fault::TargetLost, ""),
        (Fault::StreamBreaks, "follow planner away Retry"),
        (Fault::StreamSilent, "follow planner failed Retry"),
        (Fault::Stop, "follow stop Retreat"),
        (Fault::OutOfRange, "follow out of reach BackOff"),
        (Fault::Timeout, "follow no answer Retry"),
        (Fault::Disconnected, "follow no answer Retry"),
    ] {
        let shared = shared(2).with_fault(Step::Follow, fault, 1);
        let (report, log) = run(&shared, &servo()).await;
        assert_eq!(report.end, End::Empty, "{fault:?} {log:?}");
        let world = shared.world();
        assert_eq!((world.delivered, world.lost, report.tally.successes), (2, 0, 2), "{fault:?} {log:?}");
        let expected: Vec<&str> = Some(expected).filter(|e| !e.is_empty()).into_iter().collect();
        assert_eq!(log, expected, "{fault:?}");
        assert!(world.faults.iter().all(|(.., left)| *left == 0), "{fault:?} never happened");
    }
}

#[tokio::test(start_paused = true)]
async fn a_lost_target_is_left_straight_back_and_looked_for_again() {
    let lost = ServoConfig::default().lost_answers;
    let shared = shared(1).with_fault(Step::Follow, Fault::TargetLost, lost);
    let (report, log) = run(&shared, &servo()).await;
    assert_eq!((report.end, report.tally.successes, report.tally.not_executed), (End::Empty, 1, 3));
    assert_eq!(log, ["follow target lost BackOff"]);
    let world = shared.world();
    // Back to where the approach began, before anything else: the fingertips at 0.15 m.
    let after = world.moves.iter().skip_while(|(step, _)| *step != Step::Follow);
    let back = after.map(|(_, at)| at.translation.vector.z).find(|z| (z - 0.25).abs() < 1e-9);
    assert!(back.is_some(), "{:?}", world.moves);
}

#[tokio::test(start_paused = true)]
async fn a_broken_stream_holds_the_arm_and_begins_again_from_where_the_approach_began() {
    let shared = shared(1).with_fault(Step::Follow, Fault::StreamBreaks, 2);
    let (report, log) = run(&shared, &servo()).await;
    assert_eq!((report.end, report.tally.successes), (End::Empty, 1));
    assert_eq!(log, ["follow planner away Retry"; 2]);
    assert_eq!(shared.world().streams, 1 + 2 + 2);
    // One that breaks for ever is given up after its tries, and the run in its time.
    let shared = self::shared(1).with_fault(Step::Follow, Fault::StreamBreaks, u32::MAX);
    let (report, log) = run(&shared, &servo()).await;
    assert!(matches!(report.end, End::NoGrasp { .. }), "{:?}", report.end);
    assert_eq!(log.iter().filter(|line| line.ends_with("BackOff")).count(), 12, "{log:?}");
    assert_eq!((shared.world().in_tray, report.holding), (1, Holding::Nothing));
}

#[tokio::test(start_paused = true)]
async fn what_never_comes_near_is_given_up() {
    let mut config = servo();
    if let Some(servo) = &mut config.servo {
        // Fewer frames than it takes.
        servo.longest_s = 0.2;
    }
    let shared = shared(1);
    let (report, log) = run(&shared, &config).await;
    assert!(
        matches!(&report.end, End::NoGrasp { why } if why.contains("not near enough")),
        "{:?}",
        report.end
    );
    assert!(log.iter().all(|line| line == "follow target lost BackOff"), "{log:?}");
}

#[tokio::test(start_paused = true)]
async fn a_first_look_without_a_grasp_is_looked_at_again() {
    let shared = shared(1).with_fault(Step::Plan, Fault::NoGrasp, 2);
    let (report, log) = run(&shared, &servo()).await;
    assert_eq!((report.end, report.tally.successes), (End::Empty, 1));
    assert_eq!(log, ["plan no grasp PlanAgain"; 2]);
}
