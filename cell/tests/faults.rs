//! Every fault in every step: the loop ends as the table says, hangs never, and loses no object from its count.

// What tests share fails like a test.
#[allow(clippy::unwrap_used)]
mod scripted;

use graspd_cell::outcome::{End, FailureClass, Holding};
use graspd_cell::steps::Step;
use scripted::{Fault, Shared, config, run};

const DEVICE_STEPS: [Step; 12] = [
    Step::ClearView,
    Step::Capture,
    Step::Open,
    Step::Pregrasp,
    Step::Approach,
    Step::Close,
    Step::CheckContact,
    Step::Lift,
    Step::CheckHeld,
    Step::Carry,
    Step::CheckDelivered,
    Step::Release,
];
const FAULTS: [Fault; 7] = [
    Fault::Timeout,
    Fault::Hangs,
    Fault::Disconnected,
    Fault::Stop,
    Fault::Emergency,
    Fault::OutOfRange,
    Fault::Broken,
];

fn met(shared: &Shared) -> bool {
    shared.world().faults.iter().any(|(_, _, left)| *left != u32::MAX && *left != 1)
}

#[tokio::test(start_paused = true)]
async fn one_fault_in_any_step_costs_no_object() {
    for step in DEVICE_STEPS {
        for fault in FAULTS {
            let shared = Shared::new(3).with_fault(step, fault, 1);
            let (report, log) = run(&shared, &config()).await;
            if !met(&shared) {
                // This device has no such fault in this step.
                assert_eq!((&report.end, log.len()), (&End::Empty, 0), "{step} {fault:?}");
                continue;
            }
            assert!(!log.is_empty(), "{step} {fault:?}: nobody noticed");
            let world = shared.world();
            // Only a person or a place that cannot be reached at all ends the run; the rest is mended.
            let ends = matches!(fault, Fault::Emergency | Fault::Broken)
                || (fault == Fault::OutOfRange
                    && matches!(step, Step::ClearView | Step::Carry | Step::Release));
            if ends {
                assert_ne!(report.end, End::Empty, "{step} {fault:?}");
                let holds = if world.in_hand > 0 { Holding::Object } else { Holding::Nothing };
                assert_eq!(report.holding, holds, "{step} {fault:?} {report:?}");
                assert_eq!(report.tally.unknown, world.in_hand, "{step} {fault:?} {report:?}");
            } else {
                assert_eq!(report.end, End::Empty, "{step} {fault:?} {log:?}");
                assert_eq!((world.delivered, world.lost), (3, 0), "{step} {fault:?} {log:?}");
                assert_eq!(report.tally.successes, 3, "{step} {fault:?}");
            }
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_lasting_fault_in_any_step_ends_the_run_and_says_why() {
    for step in DEVICE_STEPS {
        for fault in FAULTS {
            let shared = Shared::new(2).with_fault(step, fault, u32::MAX);
            let (report, log) = run(&shared, &config()).await;
            if log.is_empty() {
                assert_eq!(report.end, End::Empty, "{step} {fault:?}");
                continue;
            }
            assert_ne!(report.end, End::Empty, "{step} {fault:?} {log:?}");
            assert!(!report.end.to_string().is_empty());
            let world = shared.world();
            assert_eq!(world.lost, 0, "{step} {fault:?} {log:?}");
            // What is in the hand is told, and so is that nobody knows.
            match report.holding {
                Holding::Nothing => assert_eq!(world.in_hand, 0, "{step} {fault:?} {log:?}"),
                Holding::Object => assert_eq!(world.in_hand, 1, "{step} {fault:?} {log:?}"),
                Holding::Unknown => assert!(report.end.needs_person(), "{step} {fault:?} {log:?}"),
            }
            assert_eq!(report.tally.successes, world.delivered, "{step} {fault:?}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_collision_on_the_approach_backs_out_and_counts_as_a_failed_trial() {
    let shared = Shared::new(1).with_fault(Step::Approach, Fault::Stop, 1);
    let (report, log) = run(&shared, &config()).await;
    assert_eq!((report.tally.trials, report.tally.successes), (2, 1));
    assert_eq!(report.tally.failures.get(&FailureClass::Collision), Some(&1));
    assert_eq!(log, ["approach stop Retreat"]);
    assert_eq!(report.tally.rate(), Some(0.5));
}

/// Opened among objects and walls, fingers may press so hard that the arm stops itself again and again. Closed as they
/// were before, they go out.
#[tokio::test(start_paused = true)]
async fn fingers_that_are_wedged_by_opening_close_again_and_go_out() {
    let shared = Shared::new(2).with_fault(Step::CheckContact, Fault::Slips, 1);
    shared.world().wedges = true;
    let (report, log) = run(&shared, &config()).await;
    assert_eq!(report.end, End::Empty, "{log:?}");
    assert_eq!((report.tally.trials, report.tally.successes), (3, 2), "{log:?}");
    assert_eq!(report.tally.failures.get(&FailureClass::UnstableContact), Some(&1));
    assert_eq!(log, ["check_contact nothing held Retreat", "retreat stop ClearAndRetry"]);
    let world = shared.world();
    let thumb: Vec<f64> = world.thumb.iter().filter(|t| t.0 == Step::Retreat).map(|t| t.1).collect();
    assert_eq!(thumb, [0.0, 1.0, 0.0], "open, closed as before, open in the air");
}

/// An arm that stands next to a singularity may refuse every straight line: the way out goes by its joints then.
#[tokio::test(start_paused = true)]
async fn where_no_straight_line_leads_out_the_joints_do() {
    let shared = Shared::new(2).with_fault(Step::CheckContact, Fault::Slips, 1);
    shared.world().no_way_up = vec![Step::Retreat];
    let (report, log) = run(&shared, &config()).await;
    assert_eq!(report.end, End::Empty, "{log:?}");
    assert_eq!((report.tally.trials, report.tally.successes), (3, 2), "{log:?}");
    assert_eq!(log, ["check_contact nothing held Retreat"]);
    assert!(shared.world().moves.iter().any(|(step, _)| *step == Step::Retreat));
}

#[tokio::test(start_paused = true)]
async fn a_stop_while_carrying_goes_on_with_the_object() {
    for step in [Step::Lift, Step::Carry] {
        let shared = Shared::new(1).with_fault(step, Fault::Stop, 2);
        let (report, log) = run(&shared, &config()).await;
        assert_eq!((report.tally.trials, report.tally.successes), (1, 1), "{log:?}");
        assert!(log.iter().all(|l| l.ends_with("stop ClearAndFeel")) && log.len() == 2, "{log:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_stop_that_shakes_the_object_off_is_noticed() {
    let shared =
        Shared::new(1).with_fault(Step::Lift, Fault::Stop, 1).with_fault(Step::Lift, Fault::Slips, 1);
    let (report, log) = run(&shared, &config()).await;
    assert_eq!(report.tally.failures.get(&FailureClass::LostLifting), Some(&1), "{log:?}");
    assert_eq!((report.tally.trials, report.tally.successes), (2, 1));
}

#[tokio::test(start_paused = true)]
async fn objects_that_slip_are_counted_where_they_slipped() {
    for (step, class) in [
        (Step::CheckContact, FailureClass::UnstableContact),
        (Step::Lift, FailureClass::LostLifting),
        (Step::Carry, FailureClass::LostCarrying),
    ] {
        let shared = Shared::new(2).with_fault(step, Fault::Slips, 1);
        let (report, _) = run(&shared, &config()).await;
        assert_eq!(report.tally.failures.get(&class), Some(&1), "{step}: {report:?}");
        let world = shared.world();
        assert_eq!((report.end, report.tally.successes), (End::Empty, world.delivered));
    }
}

#[tokio::test(start_paused = true)]
async fn a_hand_that_never_holds_ends_the_run() {
    let shared = Shared::new(1).with_fault(Step::CheckContact, Fault::Slips, u32::MAX);
    let (report, _) = run(&shared, &config()).await;
    assert!(matches!(report.end, End::Failures { .. }), "{report:?}");
    assert_eq!((report.tally.trials, report.tally.successes), (20, 0));
}

#[tokio::test(start_paused = true)]
async fn the_planner_may_be_away_for_a_long_time() {
    let shared = Shared::new(2).with_fault(Step::Plan, Fault::PlannerAway, 60);
    let (report, log) = run(&shared, &config()).await;
    assert_eq!((report.end, report.tally.successes, log.len()), (End::Empty, 2, 60));
    assert!(report.duration_s > 250.0, "back-off: {}", report.duration_s);
    let shared = Shared::new(2).with_fault(Step::Plan, Fault::PlannerAway, u32::MAX);
    let (report, _) = run(&shared, &config()).await;
    assert!(matches!(report.end, End::PlannerLost { .. }), "{report:?}");
    assert!((2000.0..2100.0).contains(&report.duration_s), "{}", report.duration_s);
}

#[tokio::test(start_paused = true)]
async fn a_planner_that_fails_is_asked_a_few_times() {
    let shared = Shared::new(1).with_fault(Step::Plan, Fault::PlannerFails, 3);
    assert_eq!(run(&shared, &config()).await.0.end, End::Empty);
    let shared = Shared::new(1).with_fault(Step::Plan, Fault::PlannerFails, u32::MAX);
    let (report, log) = run(&shared, &config()).await;
    assert!(matches!(report.end, End::PlannerLost { .. }) && log.len() == 5, "{report:?}");
}

#[tokio::test(start_paused = true)]
async fn a_lift_out_of_reach_lifts_to_the_pregrasp() {
    let shared = Shared::new(1);
    // The tool point hangs 0.1 m below the flange: the full lift ends at 0.30 m, the pre-grasp at 0.25 m.
    let mut config = config();
    config.motion.lift_m = 0.5;
    shared.world().reach_z_m = 0.55;
    let (report, log) = run(&shared, &config).await;
    assert_eq!((report.end, report.tally.successes), (End::Empty, 1), "{log:?}");
    assert_eq!(log, ["lift out of reach LiftToPregrasp"]);
}

#[tokio::test(start_paused = true)]
async fn a_grasp_out_of_reach_gives_way_to_the_next_ranked_one() {
    let shared = Shared::new(1).with_fault(Step::Approach, Fault::OutOfRange, 2);
    let (report, log) = run(&shared, &config()).await;
    assert_eq!(log, vec!["approach out of reach NextGrasp"; 2]);
    assert_eq!((report.end, report.tally.trials, report.tally.successes), (End::Empty, 1, 1));
}

#[tokio::test(start_paused = true)]
async fn a_guarded_approach_that_ends_early_closes_there_and_lifts_straight_up() {
    let shared = Shared::new(1).with_fault(Step::Approach, Fault::Contact, 1);
    shared.world().met_after = 0.95;
    let (report, log) = run(&shared, &config()).await;
    assert_eq!((&report.end, report.tally.trials, report.tally.successes), (&End::Empty, 1, 1), "{log:?}");
    let moves = shared.world().moves.clone();
    let in_step = |step| moves.iter().find(|(s, _)| *s == step).unwrap().1.translation.vector;
    let (met, lifted) = (in_step(Step::Approach), in_step(Step::Lift));
    // The planned grasp has the flange at 0.15 m, the pre-grasp at 0.25 m.
    assert!((met.z - 0.155).abs() < 1e-9, "{met}");
    assert!((lifted - met - nalgebra::Vector3::new(0.0, 0.0, 0.15)).norm() < 1e-9, "{lifted}");
}

#[tokio::test(start_paused = true)]
async fn a_trial_that_fails_after_a_contact_is_a_collision() {
    // Too far above the object to hold anything, and held but lost on the way up.
    for (met_after, slips) in [(0.5, None), (0.95, Some(Step::Lift))] {
        let mut shared = Shared::new(1).with_fault(Step::Approach, Fault::Contact, 1);
        if let Some(step) = slips {
            shared = shared.with_fault(step, Fault::Slips, 1);
        }
        shared.world().met_after = met_after;
        let (report, log) = run(&shared, &config()).await;
        assert_eq!(report.tally.failures.get(&FailureClass::Collision), Some(&1), "{met_after} {log:?}");
        assert_eq!((report.end, report.tally.trials, report.tally.successes), (End::Empty, 2, 1), "{log:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn an_object_is_not_carried_sideways_where_the_way_up_is_out_of_reach() {
    let shared = Shared::new(1);
    shared.world().no_way_up = vec![Step::Carry];
    let (report, log) = run(&shared, &config()).await;
    assert_eq!(log, ["carry out of reach End"]);
    assert!(matches!(report.end, End::ArmLost { .. }), "{report:?}");
    assert_eq!((report.holding, report.tally.unknown), (Holding::Object, 1));
    let world = shared.world();
    assert!(world.in_hand == 1 && world.moves.iter().all(|(step, _)| *step != Step::Carry), "{world:?}");
}

#[tokio::test(start_paused = true)]
async fn an_empty_hand_goes_on_where_the_way_up_is_out_of_reach() {
    let shared = Shared::new(2).with_fault(Step::Approach, Fault::Stop, 1);
    shared.world().no_way_up = vec![Step::ClearView, Step::Pregrasp];
    let (report, log) = run(&shared, &config()).await;
    assert_eq!((report.end, report.tally.successes), (End::Empty, 2), "{log:?}");
    assert_eq!(log, ["approach stop Retreat"]);
}
