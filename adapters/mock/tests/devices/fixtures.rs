//! A small world with one box in a tray, a parallel gripper above it, and a camera that looks down.

use std::sync::Arc;
use std::time::Duration;

use graspd_adapters_core::{GripCommand, Limits};
use graspd_adapters_mock::{
    ArmSettings, CameraSettings, Faults, HandSettings, MockArm, MockCamera, MockHand, Mount, SharedWorld,
    SharedWorldSettings,
};
use graspd_sim::camera::{Pinhole, look_at};
use graspd_sim::object::Object;
use graspd_sim::sensor::Sensor;
use graspd_sim::world::{HandId, Tray, World, WorldSettings};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

pub(crate) const SECOND: Duration = Duration::from_secs(1);
pub(crate) const TEN: Duration = Duration::from_secs(10);
/// Half extents of the box, metres.
pub(crate) const HALF: [f64; 3] = [0.02, 0.025, 0.025];
pub(crate) const LIMITS: Limits = Limits { speed_m_s: 0.25, acceleration_m_s2: 2.0 };

pub(crate) fn cuboid() -> Arc<Object> {
    let object = Object::cuboid("box", Vector3::from(HALF)).unwrap();
    Arc::new(Object { mass_kg: 0.1, friction: 0.7, ..object })
}

pub(crate) fn box_in_tray() -> World {
    let mut world = World::new(WorldSettings { tray: Some(Tray::default()), ..WorldSettings::default() });
    world.add(cuboid(), &Isometry3::translation(0.0, 0.0, HALF[2]));
    world
}

pub(crate) fn shared(speed: f64) -> SharedWorld {
    SharedWorld::new(box_in_tray(), SharedWorldSettings { speed, ..SharedWorldSettings::default() }).unwrap()
}

pub(crate) fn lens() -> Pinhole {
    Pinhole { width: 64, height: 48, fx_px: 60.0, fy_px: 60.0, cx_px: 31.5, cy_px: 23.5 }
}

/// A camera 0.7 m above the tray, without noise, with 10 frames per second.
pub(crate) fn camera(shared: &SharedWorld, faults: Faults) -> MockCamera {
    let world_from_camera = look_at(&Point3::new(0.0, 0.0, 0.7), &Point3::origin(), &Vector3::y());
    let settings = CameraSettings { frame_rate_hz: 10.0, ..CameraSettings::default() };
    let mount = Mount::Fixed { world_from_camera };
    MockCamera::new(shared, settings, Sensor::ideal(lens()), mount, faults).unwrap()
}

/// The root link of a hand that points down, at a place.
pub(crate) fn down(x: f64, y: f64, z: f64) -> Isometry3<f64> {
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    Isometry3::from_parts(Translation3::new(x, y, z), rotation)
}

/// The parallel gripper, open, 0.25 m above the tray's middle.
pub(crate) async fn gripper(shared: &SharedWorld) -> HandId {
    let hand = Arc::new(graspd_hands::library::hand("antipodal").unwrap().clone());
    shared.add_hand(hand, down(0.0, 0.0, 0.25), None).await.unwrap()
}

pub(crate) async fn arm(shared: &SharedWorld, faults: Faults) -> MockArm {
    MockArm::new(shared, gripper(shared).await, ArmSettings::default(), faults).unwrap()
}

pub(crate) async fn fingers(shared: &SharedWorld, hand: HandId, faults: Faults) -> MockHand {
    MockHand::new(shared, hand, HandSettings::default(), faults).await.unwrap()
}

pub(crate) fn close(to: f64) -> GripCommand {
    GripCommand { actuators: vec![to], speed: 1.0, force: 0.5 }
}

/// How far two places are from each other, metres.
pub(crate) fn apart(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    (a.translation.vector - b.translation.vector).norm()
}
