//! Pictures of an execution: the world near the grasp, moment beside moment.

use graspd_sim::camera::{Pinhole, look_at};
use graspd_sim::render::{RgbImage, picture};
use graspd_sim::world::World;
use nalgebra::{Point3, Vector3};

/// From what is looked at to the camera, metres.
const TO_EYE_M: [f64; 3] = [0.3, -0.5, 0.32];
/// What is looked at lies this far above the focus, metres.
const ABOVE_M: f64 = 0.04;
/// Focal length of a picture as a share of its height.
const FOCAL: f64 = 1.325;

/// Where to look: half-way between the table and the hand that is about to grasp, over the tray without one.
pub fn focus(world: &World) -> Point3<f64> {
    let hand = world.hand_ids().first().and_then(|&id| world.hand_state(id));
    hand.map_or_else(Point3::origin, |state| {
        let t = state.world_from_hand.translation.vector;
        Point3::new(t.x, t.y, 0.25 * t.z)
    })
}

/// The world from the front, near `focus` (world frame), in a picture of `width_px` and `height_px`.
pub fn close_up(world: &World, focus: &Point3<f64>, [width_px, height_px]: [usize; 2]) -> RgbImage {
    let f_px = FOCAL * height_px as f64;
    let lens = Pinhole {
        width: width_px,
        height: height_px,
        fx_px: f_px,
        fy_px: f_px,
        cx_px: (width_px as f64 - 1.0) / 2.0,
        cy_px: (height_px as f64 - 1.0) / 2.0,
    };
    let target = focus + Vector3::new(0.0, 0.0, ABOVE_M);
    picture(world, &lens, &look_at(&(target + Vector3::from(TO_EYE_M)), &target, &Vector3::z()))
}

/// Pictures side by side, as high as the lowest.
pub fn beside(images: &[RgbImage]) -> RgbImage {
    let height = images.iter().map(|i| i.height).min().unwrap_or(0);
    let width = images.iter().map(|i| i.width).sum();
    let row = |v: usize| images.iter().flat_map(move |i| &i.pixels[v * i.width..(v + 1) * i.width]);
    let pixels = (0..height).flat_map(row).copied().collect();
    RgbImage { width, height, pixels }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use graspd_sim::object::Object;
    use graspd_sim::world::WorldSettings;
    use nalgebra::Isometry3;

    use super::*;

    #[test]
    fn a_thing_at_the_focus_is_in_the_middle_and_pictures_stand_side_by_side() {
        let mut world = World::new(WorldSettings::default());
        let bare = close_up(&world, &focus(&world), [60, 40]);
        let cube = Object::cuboid("box", Vector3::new(0.02, 0.02, 0.03)).unwrap();
        world.add(Arc::new(cube), &Isometry3::translation(0.0, 0.0, 0.03));
        let seen = close_up(&world, &focus(&world), [60, 40]);
        let middle = 20 * 60 + 30;
        assert_ne!(bare.pixels[middle], seen.pixels[middle]);
        let both = beside(&[bare.clone(), seen.clone()]);
        assert_eq!((both.width, both.height), (120, 40));
        assert_eq!(both.pixels[120..180], bare.pixels[60..120]);
        assert_eq!(both.pixels[180..240], seen.pixels[60..120]);
    }
}
