//! A depth camera that takes one frame after the other.

use nalgebra::Isometry3;

use super::observe::Buffers;
use super::{DepthImage, Sensor};
use crate::render::{Renderer, View};
use crate::world::World;

/// A sensor with the memory for its frames: the second frame and all after it need no fresh memory, which saves a
/// good third of their time. The frames are those of [`capture`](crate::render::capture) and [`Sensor::observe`], bit
/// for bit.
#[derive(Debug, Clone)]
pub struct DepthCamera {
    sensor: Sensor,
    renderer: Renderer,
    buffers: Buffers,
    image: DepthImage,
}

/// What a [`DepthCamera`] has taken, until it takes the next.
#[derive(Debug, Clone, Copy)]
pub struct Shot<'a> {
    /// What there was to see, without noise: depth, instances, surfaces.
    pub view: &'a View,
    /// What the sensor delivers.
    pub image: &'a DepthImage,
}

impl DepthCamera {
    /// A camera with the sensor's own lens.
    pub fn new(sensor: Sensor) -> Self {
        let image = DepthImage { width: 0, height: 0, depth_m: Vec::new() };
        Self { sensor, renderer: Renderer::new(), buffers: Buffers::default(), image }
    }

    /// Its sensor.
    pub fn sensor(&self) -> &Sensor {
        &self.sensor
    }

    /// One frame of a world from a pose of the optical frame, world frame. The seed decides the noise.
    pub fn take(&mut self, world: &World, world_from_camera: &Isometry3<f64>, seed: u64) -> Shot<'_> {
        let view = self.renderer.capture(world, &self.sensor.lens, world_from_camera);
        self.sensor.observe_into(view, seed, &mut self.buffers, &mut self.image);
        Shot { view, image: &self.image }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use nalgebra::{Point3, Vector3};

    use super::*;
    use crate::camera::{Pinhole, look_at};
    use crate::object::Object;
    use crate::render::capture;
    use crate::world::{Tray, WorldSettings};

    #[test]
    fn frames_in_used_memory_are_those_in_fresh_memory() {
        let mut world = World::new(WorldSettings { tray: Some(Tray::default()), ..WorldSettings::default() });
        let object = Arc::new(Object::cuboid("box", Vector3::new(0.03, 0.02, 0.05)).unwrap());
        let first = world.add(object.clone(), &Isometry3::translation(0.05, 0.0, 0.05));
        world.add(object, &Isometry3::translation(-0.05, 0.02, 0.05));
        let mut camera = DepthCamera::new(Sensor::pico_flexx());
        let mut seen = Vec::new();
        for (seed, eye) in
            [[0.0, -0.2, 0.6], [0.3, 0.1, 0.4], [0.0, 0.0, -2.0], [0.0, -0.2, 0.6]].iter().enumerate()
        {
            let pose = look_at(&Point3::from(*eye), &Point3::origin(), &Vector3::z());
            let view = capture(&world, &camera.sensor().lens, &pose);
            let image = camera.sensor().observe(&view, seed as u64);
            let shot = camera.take(&world, &pose, seed as u64);
            // Where nothing is seen the depth is no number, which equals nothing.
            let same = |a: &[f32], b: &[f32]| a.iter().map(|x| x.to_bits()).eq(b.iter().map(|x| x.to_bits()));
            assert!(
                same(&shot.view.depth_m, &view.depth_m)
                    && same(&shot.view.cos_incidence, &view.cos_incidence)
            );
            assert_eq!((&shot.view.instance, &shot.view.albedo), (&view.instance, &view.albedo));
            assert_eq!((&shot.view.specular, shot.view.world_from_camera), (&view.specular, pose));
            assert_eq!(shot.image, &image);
            seen.push(shot.view.instance.iter().filter(|i| **i == first.number() as u16).count());
            world.remove(first);
        }
        assert!(seen[0] > 100 && seen[1] == 0 && seen[3] == 0, "{seen:?}");
    }

    #[test]
    fn a_camera_without_pixels_takes_empty_frames() {
        let lens = Pinhole { width: 0, height: 5, fx_px: 1.0, fy_px: 1.0, cx_px: 0.0, cy_px: 0.0 };
        let mut camera = DepthCamera::new(Sensor::ideal(lens));
        let shot = camera.take(&World::new(WorldSettings::default()), &Isometry3::identity(), 1);
        assert_eq!((shot.image.width, shot.image.height, shot.image.depth_m.len()), (0, 5, 0));
        assert!(shot.view.depth_m.is_empty());
    }
}
