//! Activations: a cube of cells, channels last, with a margin of zeros that convolutions read beyond its faces.

use crate::kernel::LANES;

/// Where activations lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Shape {
    /// Cells along an edge.
    pub(crate) side: usize,
    /// Channels that mean something; the rest up to `stride` are 0.
    pub(crate) channels: usize,
    /// Numbers from one cell to the next.
    pub(crate) stride: usize,
    /// Cells of zeros around the cube.
    pub(crate) margin: usize,
}

impl Shape {
    /// Room for that many channels, rounded up to whole lanes.
    pub(crate) fn new(side: usize, channels: usize) -> Self {
        Self { side, channels, stride: channels.next_multiple_of(LANES), margin: 0 }
    }

    /// Cells along an edge, margins included.
    pub(crate) fn whole(&self) -> usize {
        self.side + 2 * self.margin
    }

    /// Numbers in a plane of equal x.
    pub(crate) fn plane(&self) -> usize {
        self.whole() * self.whole() * self.stride
    }

    /// Numbers in all.
    pub(crate) fn len(&self) -> usize {
        self.whole() * self.plane()
    }

    /// Place of the first channel of a cell.
    pub(crate) fn index(&self, x: usize, y: usize, z: usize) -> usize {
        (x + self.margin) * self.plane() + self.in_plane(y, z)
    }

    /// Place of the first channel of a cell within its plane.
    pub(crate) fn in_plane(&self, y: usize, z: usize) -> usize {
        ((y + self.margin) * self.whole() + z + self.margin) * self.stride
    }

    /// Place where a window begins that reaches `pad` cells beyond the cell (x, y, z) towards the origin, and stands
    /// `dx`, `dy` cells further.
    pub(crate) fn window(&self, x: usize, y: usize, [dx, dy]: [usize; 2], pad: usize) -> usize {
        let (m, w) = (self.margin - pad, self.whole());
        (((x + dx + m) * w + y + dy + m) * w + m) * self.stride
    }
}
