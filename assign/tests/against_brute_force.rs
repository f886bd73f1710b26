//! The search against every assignment that there is, on random problems.

use graspd_assign::*;
use nalgebra::{Isometry3, Point3};
use proptest::prelude::*;

const SETTINGS: Settings = Settings {
    same_object_m: 0.03,
    clearance_m: 0.02,
    least_value: 1e-3,
    nodes: u64::MAX,
    grasps_per_arm: 64,
};

fn grasp(labelled: bool) -> impl Strategy<Value = Grasp> {
    let reach = prop_oneof![
        4 => (0.3..1.0f64).prop_map(Reach::Within),
        1 => Just(Reach::Beyond("too far".to_owned())),
        1 => Just(Reach::Unknown),
    ];
    (-0.3..0.3f64, -0.3..0.3f64, 0.0..1.0f64, 0..5i64, 0.0..0.12f64, reach).prop_map(
        move |(x, y, score, id, width, reach)| Grasp {
            world_from_pregrasp: Isometry3::translation(x, y, 0.3),
            world_from_hand: Isometry3::translation(x, y, 0.2),
            score,
            object: if labelled { ObjectKey::Id(id) } else { ObjectKey::At(Point3::new(x, y, 0.0)) },
            width_m: Some(width),
            reach,
            barred: (score > 0.97).then(|| "not this one".to_owned()),
            corridor: None,
        },
    )
}

fn arms(labelled: bool) -> impl Strategy<Value = Vec<Arm>> {
    let arm = (prop::collection::vec(grasp(labelled), 0..6), 0.0..std::f64::consts::TAU, 0.02..0.15f64);
    prop::collection::vec(arm, 1..5).prop_map(|arms| {
        (arms.into_iter().enumerate())
            .map(|(i, (grasps, angle, hand_radius_m))| Arm {
                opening_m: Some((0.0, 0.1)),
                region: ReachRegion::Shell {
                    middle: Point3::new(0.6 * angle.cos(), 0.6 * angle.sin(), 0.3),
                    min_m: 0.2,
                    max_m: 0.8,
                },
                body: Body {
                    shoulder: Point3::new(0.6 * angle.cos(), 0.6 * angle.sin(), 0.3),
                    hand_radius_m,
                    arm_radius_m: 0.04,
                    ..Body::default()
                },
                ..Arm::new(&format!("arm {i}"), grasps)
            })
            .collect()
    })
}

/// What a grasp is worth by itself, in this test's own words; `None` when it cannot be taken.
fn worth(arm: &Arm, grasp: &Grasp) -> Option<f64> {
    let reach = match (&grasp.reach, &arm.region) {
        (Reach::Within(share), _) => *share,
        (Reach::Beyond(_), _) => return None,
        (Reach::Unknown, ReachRegion::Shell { middle, min_m, max_m }) => {
            let far = (grasp.world_from_hand.translation.vector - middle.coords).norm();
            if far < *min_m || far > *max_m {
                return None;
            }
            0.5 + 0.5 * ((max_m - far) / (0.1 * (max_m - min_m))).clamp(0.0, 1.0)
        }
        _ => 1.0,
    };
    let size = size_suitability(grasp.width_m?, arm.opening_m?);
    let value = grasp.score * size * reach;
    (grasp.barred.is_none() && value >= SETTINGS.least_value).then_some(value)
}

fn compatible(arms: &[Arm], a: (usize, usize), b: (usize, usize)) -> bool {
    let of = |(arm, grasp): (usize, usize)| (&arms[arm].grasps[grasp], &arms[arm].body);
    let ((first, body), (second, other)) = (of(a), of(b));
    let sweep = |g: &Grasp, body| corridor(&g.world_from_pregrasp, &g.world_from_hand, body);
    let apart = sweep(first, body)
        .iter()
        .all(|x| sweep(second, other).iter().all(|y| x.distance(y) >= SETTINGS.clearance_m));
    apart && !first.object.is_same(&second.object, SETTINGS.same_object_m)
}

fn brute_force(arms: &[Arm], arm: usize, chosen: &mut Vec<(usize, usize)>) -> f64 {
    if arm == arms.len() {
        return 0.0;
    }
    let mut best = brute_force(arms, arm + 1, chosen);
    for grasp in 0..arms[arm].grasps.len() {
        let Some(value) = worth(&arms[arm], &arms[arm].grasps[grasp]) else { continue };
        if chosen.iter().all(|&other| compatible(arms, (arm, grasp), other)) {
            chosen.push((arm, grasp));
            best = best.max(value + brute_force(arms, arm + 1, chosen));
            chosen.pop();
        }
    }
    best
}

fn check(arms: &[Arm]) -> Result<(), TestCaseError> {
    let problem = Problem { arms, ..Problem::default() };
    let found = assign(&problem, &SETTINGS, &mut || false);
    let expected = brute_force(arms, 0, &mut Vec::new());
    prop_assert!(found.optimal);
    prop_assert!((found.value - expected).abs() < 1e-9, "{} instead of {expected}", found.value);
    let chosen: Vec<(usize, usize)> = (found.decisions.iter().enumerate())
        .filter_map(|(arm, decision)| Some((arm, decision.chosen.as_ref()?.grasp)))
        .collect();
    let mut sum = 0.0;
    for (i, &a) in chosen.iter().enumerate() {
        sum += worth(&arms[a.0], &arms[a.0].grasps[a.1]).expect("a grasp that can be taken");
        for &b in &chosen[..i] {
            prop_assert!(compatible(arms, a, b), "{a:?} and {b:?}");
        }
    }
    prop_assert!((sum - found.value).abs() < 1e-9);
    // Every grasp is a candidate or says why it is none.
    for (arm, decision) in arms.iter().zip(&found.decisions) {
        let possible = arm.grasps.iter().filter(|g| worth(arm, g).is_some()).count();
        prop_assert_eq!(possible + decision.rejected.len(), arm.grasps.len());
        prop_assert!(!decision.reason.to_string().is_empty());
    }
    prop_assert_eq!(&assign(&problem, &SETTINGS, &mut || false), &found);
    // Stopped at once it is a valid answer with a bound.
    let hasty = assign(&problem, &Settings { nodes: 1, ..SETTINGS }, &mut || true);
    prop_assert!(hasty.value <= found.value + 1e-9 && hasty.bound >= found.value - 1e-9);
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn by_label(arms in arms(true)) {
        check(&arms)?;
    }

    #[test]
    fn by_position(arms in arms(false)) {
        check(&arms)?;
    }
}

fn plain(x: f64, score: f64) -> Grasp {
    Grasp {
        world_from_pregrasp: Isometry3::translation(x, 0.0, 0.3),
        world_from_hand: Isometry3::translation(x, 0.0, 0.2),
        score,
        object: ObjectKey::At(Point3::new(x, 0.0, 0.0)),
        width_m: None,
        reach: Reach::Within(1.0),
        barred: None,
        corridor: None,
    }
}

fn reasons(problem: &Problem<'_>) -> Vec<String> {
    let found = assign(problem, &Settings::default(), &mut || false);
    found.decisions.iter().map(|d| d.reason.to_string()).collect()
}

#[test]
fn every_decision_says_why() {
    let wall = KeepOut {
        name: "the fence".to_owned(),
        volume: OrientedBox {
            pose: Isometry3::translation(0.2, 0.0, 0.2),
            half_extents_m: [0.01, 0.3, 0.3].into(),
        },
    };
    let mut narrow = Arm { opening_m: Some((0.0, 0.085)), ..Arm::new("narrow", vec![plain(-0.2, 0.9)]) };
    narrow.grasps[0].width_m = Some(0.11);
    let mut far = Arm::new("far", vec![plain(0.0, 0.9)]);
    far.grasps[0].reach = Reach::Beyond("shoulder singularity".to_owned());
    let arms = [
        Arm::new("first", vec![plain(-0.2, 0.9)]),
        Arm::new("second", vec![plain(-0.2, 0.95), plain(0.2, 0.5)]),
        Arm::new("third", vec![plain(-0.2, 0.8)]),
        Arm { keep_out: vec![wall], ..Arm::new("fenced", vec![plain(0.2, 0.9)]) },
        narrow,
        far,
        Arm::new("empty", Vec::new()),
    ];
    let told = reasons(&Problem { arms: &arms, ..Problem::default() });
    assert_eq!(told[0], "its best grasp");
    assert_eq!(told[1], "best together: 1 of its grasps are worth more; at the best first takes the object");
    assert_eq!(told[2], "idle: at its best grasp first takes the object");
    assert!(told[3].contains("keep_out 1") && told[3].contains("the way enters the fence"), "{}", told[3]);
    assert!(told[4].contains("0.110 m wide, the hand takes 0.000 to 0.085 m"), "{}", told[4]);
    assert!(told[5].contains("out of reach: shoulder singularity"), "{}", told[5]);
    assert_eq!(told[6], "idle: no grasp was planned for its hand");
    let occupied = [Occupied {
        by: "fourth".to_owned(),
        space: std::sync::Arc::new(Swept::new(vec![Capsule {
            a: Point3::origin(),
            b: Point3::new(0.0, 0.0, 0.3),
            radius_m: 0.5,
        }])),
    }];
    let told = reasons(&Problem { arms: &arms[..1], occupied: &occupied, taken: &[] });
    assert!(told[0].contains("fourth is in the way"), "{}", told[0]);
    let taken = [Taken { by: "fifth".to_owned(), object: ObjectKey::At(Point3::new(-0.21, 0.0, 0.0)) }];
    let told = reasons(&Problem { arms: &arms[..1], occupied: &[], taken: &taken });
    assert!(told[0].contains("fifth has the object"), "{}", told[0]);
}

#[test]
fn too_many_grasps_are_cut_to_the_best_of_each_object_and_it_is_told() {
    let many = |name: &str| {
        let near = (0..500).map(|i| plain(-0.2, 0.9 - 1e-4 * f64::from(i)));
        Arm::new(name, near.chain([plain(0.2, 0.3)]).collect())
    };
    let arms = [many("first"), many("second")];
    let found = assign(&Problem { arms: &arms, ..Problem::default() }, &Settings::default(), &mut || false);
    assert!((found.value - 1.2).abs() < 1e-9, "both objects are taken: {}", found.value);
    assert!(!found.optimal && found.bound >= found.value);
}
