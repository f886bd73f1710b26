//! Tests of scene files: there and back, and hostile.

use std::sync::OnceLock;

use graspd_hands::{CoordinateKind, Hand, library};
use proptest::prelude::*;

use super::*;
use crate::clutter::{Arrangement, arrange, assortment};
use crate::object::{Kind, MeshOptions};
use crate::world::{Command, Tray, WorldSettings};

/// A settled world with a member of each family and a user's mesh.
fn full() -> World {
    let settings = WorldSettings { tray: Some(Tray::default()), ..WorldSettings::default() };
    let mut objects = assortment(Kind::ALL.len(), 4);
    let mesh = (*Object::sample(Kind::Tee, 2).mesh).clone();
    objects.push(Arc::new(Object::from_mesh("my \"tee\"", mesh, &MeshOptions::default()).unwrap()));
    arrange(&settings, &objects, Arrangement::Packed, 4).unwrap()
}

/// A small valid file with both sorts of source.
fn small() -> &'static str {
    static TEXT: OnceLock<String> = OnceLock::new();
    TEXT.get_or_init(|| {
        let mut world = World::new(WorldSettings { tray: Some(Tray::default()), ..WorldSettings::default() });
        world.add(Arc::new(Object::sample(Kind::Cup, 1)), &Isometry3::translation(0.1, 0.0, 0.06));
        let mesh = Mesh::cuboid(nalgebra::Vector3::new(0.02, 0.03, 0.04));
        let block = Object::from_mesh("block", mesh, &MeshOptions::default()).unwrap();
        world.add(Arc::new(block), &Isometry3::translation(-0.1, 0.0, 0.04));
        to_json(&world)
    })
}

/// Closes a hand in a world for a few steps: what hands are set to matters only then.
fn use_hand(world: &mut World) {
    static HAND: OnceLock<Arc<Hand>> = OnceLock::new();
    let hand = HAND.get_or_init(|| Arc::new(library::hand("robotiq-3f").unwrap().clone()));
    let id = world.add_hand(Arc::clone(hand), &Isometry3::translation(0.0, 0.0, 0.3), &hand.actuation.open());
    let actuators = hand.actuation.coordinates.iter().filter(|c| c.kind == CoordinateKind::Actuator);
    let actuators = actuators.map(|c| c.closed).collect();
    world.command(id, Command::Close { actuators, force: 1.0, speed: 1.0 });
    world.command(
        id,
        Command::Move { world_from_hand: Isometry3::identity(), speed_m_s: 0.1, turn_rad_s: 1.0 },
    );
    for _ in 0..3 {
        world.step();
    }
    assert!(world.hand_state(id).is_some());
}

fn error(text: &str) -> SceneError {
    from_json(text).map(|_| ()).unwrap_err()
}

#[test]
fn a_scene_comes_back_as_it_was() {
    let world = full();
    let text = to_json(&world);
    let back = from_json(&text).unwrap();
    assert_eq!(world.settings(), back.settings());
    assert_eq!(world.ids(), back.ids());
    for id in world.ids() {
        let (a, b) = (world.pose(id).unwrap(), back.pose(id).unwrap());
        assert!((a.translation.vector - b.translation.vector).norm() < 1e-12);
        assert!((a.rotation.coords - b.rotation.coords).norm() < 1e-12);
        assert_eq!(world.object(id), back.object(id));
    }
}

#[test]
fn settings_may_be_left_out() {
    let world = from_json(r#"{"graspd_scene": 1, "settings": {"gravity": 1.62}, "objects": []}"#).unwrap();
    assert_eq!(*world.settings(), WorldSettings { gravity: 1.62, ..WorldSettings::default() });
}

#[test]
fn what_is_wrong_is_named() {
    for (from, to, field, expected) in [
        ("\"graspd_scene\":1", "\"graspd_scene\":2", "scene.graspd_scene", "1, the version"),
        ("\"graspd_scene\":1", "\"other\":1", "scene.graspd_scene", "the version"),
        ("\"gravity\":", "\"levity\":", "scene.settings", "unknown field `levity`"),
        ("\"gravity\":9.81", "\"gravity\":-9.81", "settings.gravity", "0 to 100"),
        ("\"turn_rad_s\":2.5", "\"turn_rad_s\":-1", "settings.hands.turn_rad_s", "0.001 to 100"),
        ("\"servo_time_s\":0.02", "\"servo_time_s\":-1", "settings.hands.servo_time_s", "0.0001 to 1"),
        ("\"arm_mass_kg\":20.0", "\"arm_mass_kg\":0", "settings.hands.arm_mass_kg", "0.1 to 1000"),
        ("\"contact_hz\":200.0", "\"contact_hz\":-200", "settings.contact_hz", "1 to 10000"),
        ("\"name\":\"cup\"", "\"name\":\"cup\",\"color\":3", "objects[0].color", "no such field"),
        ("\"top_radius_m\":0", "\"top_radius_m\":-0", "objects[0].source.family.cup.top_radius_m", " to "),
        ("\"cup\":{", "\"vase\":{", "objects[0].source", "unknown variant `vase`"),
        ("\"friction\":0.5,\"mass_kg\"", "\"friction\":-1,\"mass_kg\"", "objects[1].friction", "0 to 10"),
        ("[-0.1,0.0,", "[-1e3,0.0,", "objects[1].position_m", "-10 to 10"),
        ("[0.0,0.0,0.0,1.0]", "[0.0,0.0,0.0,0.0]", "objects[0].orientation_xyzw: length", "0.999"),
        ("\"triangles\":[[0,1,2],", "\"triangles\":[", "objects[1].source.mesh", "closed"),
        ("\"triangles\":[[0,1,2],", "\"triangles\":[[0,1,9],", "objects[1].source.mesh", "indices"),
    ] {
        assert!(small().contains(from), "{from} not in {}", small());
        let SceneError::Field { field: found, expected: says, .. } = error(&small().replacen(from, to, 1));
        assert_eq!(found, field, "{to}: {says}");
        assert!(says.contains(expected), "{field}: {says:?} does not say {expected:?}");
    }
    assert!(error("[1, 2]").to_string().starts_with("scene: found [1,2], expected an object"));
    assert!(error("{").to_string().contains("JSON"));
    assert!(error(&"[".repeat(100_000)).to_string().contains("recursion"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// Bytes changed, cut out, doubled: an error or a world that a hand can be used in, never a panic.
    #[test]
    fn no_text_makes_it_panic(
        edits in proptest::collection::vec(
            (any::<prop::sample::Index>(), "[0-9eE.,:{}\\[\\]\"a-z-]{0,3}", 0..4_usize), 1..4,
        ),
    ) {
        let mut text: Vec<char> = small().chars().collect();
        for (at, new, cut) in edits {
            let at = at.index(text.len());
            let end = (at + cut).min(text.len());
            text.splice(at..end, new.chars());
        }
        if let Ok(mut world) = from_json(&text.into_iter().collect::<String>()) {
            use_hand(&mut world);
        }
    }

    /// Numbers replaced by extreme ones.
    #[test]
    fn no_number_makes_it_panic(at in any::<prop::sample::Index>(), number in prop::sample::select(vec![
        "0", "-0.0", "-1", "1e308", "-1e308", "1e-308", "4294967295", "18446744073709551616", "0.5", "1e-9", "null",
        "[]",
    ])) {
        let text = small();
        let is_number = |c: char| c.is_ascii_digit() || "+-.eE".contains(c);
        let starts: Vec<usize> = text.char_indices().zip(text.chars().skip(1))
            .filter(|&((_, before), c)| ",:[".contains(before) && (c.is_ascii_digit() || c == '-'))
            .map(|((i, _), _)| i + 1).collect();
        let start = starts[at.index(starts.len())];
        let end = start + text[start..].find(|c| !is_number(c)).unwrap();
        let text = format!("{}{number}{}", &text[..start], &text[end..]);
        if let Ok(mut world) = from_json(&text) {
            use_hand(&mut world);
        }
    }
}
