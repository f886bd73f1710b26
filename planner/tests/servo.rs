//! The servo from its first frame to the grasp: what it follows, what it notices, what it refuses.

#[allow(dead_code)] // other tests use the rest
mod clutter;
mod palm;

use graspd_planner::budget::Unlimited;
use graspd_planner::options::KeepOut;
use graspd_planner::servo::{Answer, Bounds, Loss, Refused, Replan, ServoOptions, State};
use nalgebra::{Isometry3, Vector3};
use palm::{Rig, middle};

use clutter::Object;

/// As by default, but nearer in fewer frames.
fn quick() -> ServoOptions {
    let mut options = ServoOptions::default();
    options.standoff.speed_m_s = 0.15;
    options
}

/// Five objects with room between them.
fn few() -> Vec<Object> {
    vec![
        ([0.0, 0.0], 0.022, false),
        ([0.12, 0.02], 0.025, true),
        ([-0.12, 0.03], 0.02, false),
        ([0.02, 0.12], 0.024, true),
        ([-0.05, -0.12], 0.02, false),
    ]
}

/// The object that a grasp is at.
fn target_of(rig: &Rig, answer: &Answer) -> usize {
    let at = answer.grasp.as_ref().expect("a grasp").centroid;
    let apart = |i: &usize| (middle(&rig.objects[*i]) - at).xy().norm();
    (0..rig.objects.len()).min_by(|a, b| apart(a).total_cmp(&apart(b))).expect("objects")
}

/// Frames until the hand may go in.
fn until_go(rig: &mut Rig, most: usize) -> Vec<Answer> {
    let mut answers = Vec::new();
    for _ in 0..most {
        answers.push(rig.step().expect("a frame that is looked at"));
        if answers.last().is_some_and(|a| a.go) {
            return answers;
        }
    }
    let tail: Vec<_> = answers.iter().rev().take(5).map(|a| (a.state, a.standoff_m, a.visible)).collect();
    panic!("never goes in; last: {tail:?}");
}

fn bounded(answers: &[Answer], bounds: &Bounds) {
    for a in answers.iter().filter(|a| a.state == State::Tracking) {
        let c = &a.change;
        assert!(
            c.translation_m <= bounds.translation_m + 1e-9 && c.rotation_rad <= bounds.rotation_rad + 1e-9,
            "frame {}: {c:?}",
            a.sequence
        );
    }
}

#[test]
fn comes_nearer_smoothly_and_goes_in_at_the_object() {
    for hand in ["robotiq-2f85", "leap"] {
        let options = quick();
        let mut rig = Rig::new(hand, few(), options.clone());
        let answers = until_go(&mut rig, 300);
        assert_eq!(answers[0].state, State::Replanning(Replan::First), "{hand}");
        assert_eq!(answers[0].standoff_m, options.standoff.start_m);
        bounded(&answers, &options.bounds);
        let tracking = answers.iter().filter(|a| a.state == State::Tracking).count();
        assert!(10 * tracking >= 7 * answers.len(), "{hand}: {tracking} of {}", answers.len());
        let last = answers.last().unwrap();
        assert!(last.is_settled && last.state == State::Tracking);
        assert_eq!(last.standoff_m, options.standoff.end_m);
        let at = last.grasp.as_ref().unwrap().centroid;
        let apart = (middle(&rig.objects[target_of(&rig, last)]) - at).xy().norm();
        assert!(apart < 0.012, "{hand}: {apart} m from the object's middle");
    }
}

#[test]
fn where_nothing_moves_the_grasp_stays_where_it_was_planned() {
    // Another side of an object comes to be seen on the way, and its middle seems to move.
    for hand in ["robotiq-2f85", "robotiq-3f"] {
        let mut rig = Rig::new(hand, few(), quick());
        let answers = until_go(&mut rig, 120);
        let at = |a: &Answer| a.grasp.as_ref().expect("a grasp").world_from_hand.translation.vector;
        let anew =
            answers.iter().rposition(|a| matches!(a.state, State::Replanning(_))).expect("the first plan");
        let drift = (at(&answers[answers.len() - 1]) - at(&answers[anew])).norm();
        assert!(drift <= 0.004, "{hand}: {drift} m since frame {anew}");
        assert!(anew <= answers.len() / 2, "{hand}: planned anew in frame {anew} of {}", answers.len());
    }
}

#[test]
fn follows_a_nudged_object() {
    let mut rig = Rig::new("robotiq-3f", few(), quick());
    let first = rig.step().unwrap();
    let target = target_of(&rig, &first);
    for _ in 0..12 {
        rig.step().unwrap();
    }
    rig.objects[target].0[0] += 0.02;
    rig.objects[target].0[1] -= 0.015;
    let answers = until_go(&mut rig, 300);
    bounded(&answers, &ServoOptions::default().bounds);
    let at = answers.last().unwrap().grasp.as_ref().unwrap().centroid;
    let apart = (middle(&rig.objects[target]) - at).xy().norm();
    assert!(apart < 0.014, "{apart} m from where the object is now");
}

#[test]
fn announces_that_it_plans_anew_where_the_object_has_gone_further() {
    let mut rig = Rig::new("robotiq-3f", few()[..1].to_vec(), quick());
    for _ in 0..12 {
        rig.step().unwrap();
    }
    rig.objects[0].0 = [0.07, 0.02];
    let answers = until_go(&mut rig, 300);
    assert!(
        answers.iter().any(|a| a.state == State::Replanning(Replan::TargetMoved)),
        "{:?}",
        answers.iter().map(|a| a.state).collect::<Vec<_>>()
    );
    let last = answers.last().unwrap();
    let apart = (middle(&rig.objects[0]) - last.grasp.as_ref().unwrap().centroid).xy().norm();
    assert!(apart < 0.014, "{apart} m from where the object is now");
    assert!(last.counters.replanned >= 2);
}

#[test]
fn says_that_the_object_was_taken_away_and_finds_it_again() {
    let mut rig = Rig::new("robotiq-3f", few(), quick());
    let target = target_of_first(&mut rig);
    for _ in 0..15 {
        rig.step().unwrap();
    }
    let taken = rig.objects.remove(target);
    let lost = (0..20).find_map(|_| match rig.step().unwrap() {
        a if matches!(a.state, State::Lost(_)) => Some(a),
        _ => None,
    });
    let lost = lost.expect("the loss is noticed");
    assert_eq!(lost.state, State::Lost(Loss::TargetGone));
    assert!(!lost.go);
    rig.objects.push(taken);
    let again = (0..30).map(|_| rig.step().unwrap().state).find(|s| !matches!(s, State::Lost(_)));
    assert_eq!(again, Some(State::Replanning(Replan::FoundAgain)));
}

fn target_of_first(rig: &mut Rig) -> usize {
    let first = rig.step().expect("a frame that is looked at");
    target_of(rig, &first)
}

#[test]
fn a_target_that_stays_hidden_is_lost() {
    let mut rig = Rig::new("robotiq-3f", few(), quick());
    for _ in 0..10 {
        rig.step().unwrap();
    }
    // A hand right before the camera: nothing but holes behind it.
    let states: Vec<State> = (0..60)
        .map(|_| {
            let mut frame = rig.frame();
            frame.frame.image.depth_m.fill(0.0);
            let answer = rig.servo.step(frame, &Unlimited).unwrap();
            assert!(!answer.go && answer.visible == 0.0);
            answer.state
        })
        .collect();
    assert_eq!(states[0], State::Tracking, "a moment is bridged");
    assert_eq!(*states.last().unwrap(), State::Lost(Loss::Hidden));
}

#[test]
fn a_camera_too_near_to_see_its_target_goes_on_to_it() {
    // A sensor that measures nothing nearer than 22 cm, and what that means for the target's middle.
    let options = ServoOptions { blind_within_m: 0.26, ..quick() };
    let mut rig = Rig::new("robotiq-3f", few(), options);
    let mut was_blind = false;
    for _ in 0..300 {
        let mut frame = rig.frame();
        for d in &mut frame.frame.image.depth_m {
            if *d < 0.22 {
                *d = 0.0;
            }
        }
        let answer = rig.take(frame).expect("a frame that is looked at");
        was_blind |= answer.visible < 0.1;
        if answer.go {
            assert!(was_blind, "the test tests nothing: it saw its target all the way");
            return;
        }
    }
    panic!("never goes in");
}

#[test]
fn refuses_frames_that_are_late_repeated_wild_or_broken_and_counts_them() {
    let mut rig = Rig::new("robotiq-2f85", few(), quick());
    let first = rig.frame();
    rig.servo.step(first.clone(), &Unlimited).unwrap();
    assert!(matches!(rig.servo.step(first.clone(), &Unlimited), Err(Refused::Repeated { sequence: 1 })));
    rig.step().unwrap();
    assert!(matches!(rig.servo.step(first, &Unlimited), Err(Refused::Late { sequence: 1, answered: 2 })));
    let mut wild = rig.frame();
    wild.frame.world_from_camera = Some(Isometry3::translation(5.0, 0.0, 1.0));
    assert!(matches!(rig.servo.step(wild, &Unlimited), Err(Refused::WildPose { .. })));
    let mut broken = rig.frame();
    broken.frame.image.depth_m.pop();
    assert!(matches!(rig.servo.step(broken, &Unlimited), Err(Refused::Frame(_))));
    let mut without_pose = rig.frame();
    without_pose.frame.world_from_camera = None;
    assert!(matches!(rig.servo.step(without_pose, &Unlimited), Err(Refused::MissingPose)));
    let answer = rig.step().unwrap();
    let c = answer.counters;
    assert_eq!((c.answered, c.repeated, c.late, c.wild, c.invalid), (3, 1, 1, 1, 2));
}

/// Four walls about the middle of the table, so far from it and so high, metres.
fn walls(far_m: f64, high_m: f64) -> Vec<KeepOut> {
    let wall = |x: f64, y: f64, half: [f64; 3]| KeepOut {
        world_from_box: Isometry3::translation(x, y, high_m / 2.0),
        half_extents_m: Vector3::from(half),
    };
    let (at, long, high) = (far_m + 0.01, far_m + 0.02, high_m / 2.0);
    vec![
        wall(-at, 0.0, [0.01, long, high]),
        wall(at, 0.0, [0.01, long, high]),
        wall(0.0, -at, [long, 0.01, high]),
        wall(0.0, at, [long, 0.01, high]),
    ]
}

#[test]
fn what_lies_still_between_walls_is_found_sooner_or_later_and_then_not_given_up() {
    let mut later = 0;
    for (seed, far_m) in [(2, 0.065), (3, 0.07), (6, 0.065), (11, 0.07)] {
        let mut options = quick();
        options.plan.seed = seed;
        options.plan.keep_out = walls(far_m, 0.08);
        let mut rig = Rig::new("robotiq-3f", vec![([0.0, 0.0], 0.022, seed % 2 == 0)], options);
        let first = (0..5).position(|_| rig.step().expect("a frame that is looked at").grasp.is_some());
        // Frames of a scene that lies still are alike: without other candidates the next search would be as vain.
        later += usize::from(first.unwrap_or_else(|| panic!("no grasp of five searches, seed {seed}")) > 0);
        let answers = until_go(&mut rig, 120);
        let lost = answers.iter().filter(|a| matches!(a.state, State::Lost(_))).count();
        assert_eq!(lost, 0, "seed {seed}");
    }
    assert!(later > 0, "all were found in the first frame: nothing is proven");
}

#[test]
fn the_static_mode_keeps_its_first_grasp_whatever_it_sees() {
    let mut rig = Rig::new("robotiq-3f", few(), ServoOptions::of_first_frame());
    let first = rig.step().unwrap();
    let target = target_of(&rig, &first);
    rig.objects[target].0[0] += 0.05;
    let answers = until_go(&mut rig, 300);
    let last = answers.last().unwrap();
    assert_eq!(last.grasp, first.grasp);
    assert_eq!(last.counters.replanned, 1);
}

#[test]
fn an_empty_table_is_a_loss_with_its_reason_and_what_comes_is_planned() {
    let mut rig = Rig::new("robotiq-2f85", Vec::new(), quick());
    let answer = rig.step().unwrap();
    assert!(matches!(answer.state, State::Lost(Loss::NoGrasp(_))), "{:?}", answer.state);
    assert!(answer.grasp.is_none() && answer.world_from_standoff.is_none());
    rig.objects = few();
    let found = (0..20).map(|_| rig.step().unwrap().state).find(|s| !matches!(s, State::Lost(_)));
    assert_eq!(found, Some(State::Replanning(Replan::First)));
}

#[test]
fn same_frames_same_answers() {
    let run = || {
        let mut rig = Rig::new("robotiq-3f", few(), quick());
        (0..8).map(|_| rig.step().unwrap()).collect::<Vec<_>>()
    };
    let one = rayon_pool(1).install(run);
    let two = rayon_pool(2).install(run);
    assert_eq!(one, two, "on any number of threads");
}

fn rayon_pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool")
}

#[test]
fn options_that_make_no_sense_are_named() {
    let broken = ServoOptions { window_voxels: 57, ..ServoOptions::default() };
    assert_eq!(broken.validate().unwrap_err().field, "window_voxels");
    let mut broken = ServoOptions::default();
    broken.standoff.end_m = 0.2;
    assert_eq!(broken.validate().unwrap_err().field, "standoff.start_m");
    broken.standoff.end_m = f64::NAN;
    assert!(broken.validate().is_err());
    assert_eq!(ServoOptions::of_first_frame().validate(), Ok(()));
}

#[test]
fn a_grasp_that_has_become_worse_gives_way_to_one_that_scores_more() {
    // The target becomes thinner and slips while the hand comes: what was planned holds less of it.
    let mut announced = 0;
    for (thinner_m, slip_m) in
        [(0.004, 0.0), (0.004, 0.004), (0.004, -0.004), (0.003, 0.0), (0.005, 0.006), (0.006, -0.003)]
    {
        let margin = 0.02;
        let options = ServoOptions { reconsider_every: 0, reconsider_margin: margin, ..quick() };
        let mut rig = Rig::new("brunel", few(), options);
        let mut scores = Vec::new();
        for frame in 0..60 {
            let answer = rig.step().unwrap();
            if frame == 8 {
                let target = target_of(&rig, &answer);
                rig.objects[target].1 -= thinner_m;
                rig.objects[target].0[1] += slip_m;
            }
            let score = answer.grasp.as_ref().map_or(0.0, |grasp| grasp.score);
            if answer.state == State::Replanning(Replan::Worse) {
                announced += 1;
                let before = scores.last().copied().unwrap_or(0.0);
                assert!(score > before, "{score} in place of {before}");
                assert!(before <= scores[0] - 0.1, "{before} is hardly less than {}", scores[0]);
            }
            scores.push(score);
        }
    }
    assert!(announced > 0, "no grasp fell, or nothing better was found");
}
