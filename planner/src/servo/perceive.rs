//! What a frame adds to what is known: the hand is masked, the rest fused, the table's height followed; and how much of
//! the target it shows.

use nalgebra::Isometry3;

use super::admission::Refused;
use super::follow::Following;
use super::tracker::{HandNow, Servo};
use super::window::Memory;
use crate::budget::Unlimited;
use crate::frame::Frame;
use crate::options::WorkspaceRequest;
use crate::scene;
use crate::workspace::{frame_points, table_height};

/// Where the target must show something, metres about its middle.
const TARGET_RADIUS_M: f64 = 0.02;
/// The table's height is looked for again with every so many frames: depth cameras are off by other amounts from near by.
const TABLE_EVERY: u64 = 4;
/// Heights further than this from the known one are another surface, metres.
const SAME_TABLE_M: f64 = 0.012;

impl Servo {
    /// Makes holes where the frame shows the hand itself.
    pub(super) fn mask(
        &mut self,
        frame: &mut Frame,
        world_from_camera: &Isometry3<f64>,
        world_from_hand: Option<&Isometry3<f64>>,
        hand: Option<&HandNow>,
    ) {
        let Some(world_from_hand) = world_from_hand else { return };
        let told = hand.filter(|h| !h.joints.is_empty()).map(|h| h.joints.clone());
        let joints = told.unwrap_or_else(|| self.hand.actuation.joints(&self.hand.actuation.open()));
        self.masking.apply(frame, world_from_camera, &self.hand, world_from_hand, &joints);
    }

    /// Fuses a frame into what is remembered; the first one decides where the volume stands.
    pub(super) fn remember(
        &mut self,
        frame: &Frame,
        depth: &[f32],
        world_from_camera: &Isometry3<f64>,
    ) -> Result<(), Refused> {
        let Some(memory) = &mut self.memory else {
            let (workspace, volume) =
                scene::look(std::slice::from_ref(frame), &self.options.scene).map_err(Refused::Scene)?;
            let window = self.options.window_voxels;
            self.memory = Some(Memory::new(volume, workspace.world_from_volume, window));
            return Ok(());
        };
        let camera_from_volume = world_from_camera.inverse() * memory.world_from_volume;
        memory.volume.update(frame, depth, &camera_from_volume, self.options.memory);
        let is_given =
            matches!(self.options.scene.workspace, WorkspaceRequest::Placed { table_m: Some(_), .. });
        if let Some(table) = memory.volume.table_m
            && !is_given
            && self.counters.answered.is_multiple_of(TABLE_EVERY)
        {
            let points = frame_points(frame, depth, &Unlimited);
            let size = memory.volume.grid.size_m;
            let seen = table_height(&points, &memory.world_from_volume, size);
            if let Some(seen) = seen.filter(|s| (s - table).abs() <= SAME_TABLE_M) {
                memory.volume.table_m = Some(table + 0.5 * (seen - table));
            }
        }
        Ok(())
    }

    /// Share of the target's place that a frame shows.
    pub(super) fn visible(
        &self,
        frame: &Frame,
        depth: &[f32],
        world_from_camera: &Isometry3<f64>,
        following: &Following,
    ) -> f64 {
        let at = world_from_camera.inverse_transform_point(&following.target.position);
        let Some([u, v]) = frame.intrinsics.project([at.x, at.y, at.z]) else { return 0.0 };
        let (width, height) = (frame.image.width as isize, frame.image.height as isize);
        let reach = (frame.intrinsics.fx_px * TARGET_RADIUS_M / at.z.max(0.05)).clamp(1.0, 64.0) as isize;
        let (mut shown, mut all) = (0, 0);
        for dv in -reach..=reach {
            for du in -reach..=reach {
                all += 1;
                let (x, y) = (u.round() as isize + du, v.round() as isize + dv);
                if (0..width).contains(&x) && (0..height).contains(&y) {
                    shown += i32::from(depth[(y * width + x) as usize] > 0.0);
                }
            }
        }
        f64::from(shown) / f64::from(all.max(1))
    }
}
