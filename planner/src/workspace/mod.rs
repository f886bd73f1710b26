//! Where the volume stands in the world: given by the caller, or placed on the table that the frame shows.

mod placing;
mod plane;
mod points;

pub(crate) use placing::table_height;
pub use plane::{Plane, find_table};
pub use points::{FramePoints, frame_points};

use nalgebra::Isometry3;

use crate::grid::Grid;
use crate::options::WorkspaceRequest;

/// Height of the table top above the cube's floor when the cube is placed on a table, metres. The contact
/// dataset's volumes have it there.
pub const TABLE_HEIGHT_M: f64 = 0.10;

/// A placed volume.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Workspace {
    /// Takes volume coordinates to world coordinates.
    pub world_from_volume: Isometry3<f64>,
    /// The voxel grid.
    pub grid: Grid,
    /// Height of the table top in the volume, metres along z; `None` when there is no table.
    pub table_m: Option<f64>,
}

impl Workspace {
    /// Places the volume as asked, looking at the points of the first frame.
    ///
    /// [`WorkspaceRequest::Auto`] finds the table and stands the cube on it around what is there, z up along the
    /// table's normal, yaw along the camera's horizontal axis, table top at [`TABLE_HEIGHT_M`]; without a table
    /// the cube surrounds the median of the points. A placed volume without a table height gets the height of the
    /// horizontal surface that fills most of it, if there is one.
    pub fn place(request: &WorkspaceRequest, grid: Grid, points: &FramePoints) -> Self {
        match *request {
            WorkspaceRequest::Placed { world_from_volume, table_m } => {
                let table_m =
                    table_m.or_else(|| placing::table_height(points, &world_from_volume, grid.size_m));
                Self { world_from_volume, grid, table_m }
            }
            WorkspaceRequest::Auto => match find_table(points) {
                Some(table) => Self {
                    world_from_volume: placing::on_table(points, &table, grid.size_m),
                    grid,
                    table_m: Some(TABLE_HEIGHT_M.min(0.5 * grid.size_m)),
                },
                None => Self {
                    world_from_volume: placing::around_median(points, grid.size_m),
                    grid,
                    table_m: None,
                },
            },
        }
    }
}
