//! Lines through a mesh: every crossing, quickly, and which parts of the line lie inside.

use graspd_sim::mesh::Mesh;
use nalgebra::{Point3, Unit, Vector3};

use crate::evaluate::ap::meet;

/// Triangles in a leaf.
const LEAF: usize = 4;
/// Crossings nearer than this in the same sense are one, at an edge that two triangles share, metres.
const SAME_M: f64 = 1e-7;
/// Solid parts shorter than this are none, metres.
const LEAST_M: f64 = 1e-6;

/// Where a line meets a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Crossing {
    /// Along the line's direction from its origin, metres; negative behind it.
    pub(crate) at_m: f64,
    /// Outward normal.
    pub(crate) normal: Unit<Vector3<f64>>,
}

/// A part of a line that lies inside the solid, from surface to surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Span {
    pub(crate) from: Crossing,
    pub(crate) to: Crossing,
}

/// A node of the tree: a box, and where to go on.
#[derive(Debug, Clone, Copy)]
struct Node {
    low: Point3<f64>,
    high: Point3<f64>,
    /// First triangle of a leaf, or the second child; the first child follows its parent.
    next: u32,
    /// Triangles of a leaf; 0 for a node with children.
    count: u32,
}

/// A mesh's triangles in a tree of boxes.
#[derive(Debug)]
pub(crate) struct Lines {
    nodes: Vec<Node>,
    triangles: Vec<[Point3<f64>; 3]>,
}

impl Lines {
    /// The tree of a mesh, in its frame.
    pub(crate) fn new(mesh: &Mesh) -> Self {
        let mut triangles: Vec<_> = (0..mesh.triangles.len()).map(|t| mesh.corners(t)).collect();
        let mut nodes = Vec::new();
        if !triangles.is_empty() {
            let all = triangles.len();
            build(&mut nodes, &mut triangles, 0, all);
        }
        Self { nodes, triangles }
    }

    /// Every crossing of the whole line, in no order.
    fn crossings(&self, origin: &Point3<f64>, direction: &Unit<Vector3<f64>>, out: &mut Vec<Crossing>) {
        out.clear();
        let inverse = direction.map(|d| 1.0 / d);
        let mut stack = vec![0u32];
        while let Some(at) = stack.pop() {
            let Some(node) = self.nodes.get(at as usize) else { continue };
            if !passes(node, origin, &inverse) {
                continue;
            }
            if node.count == 0 {
                stack.extend([node.next, at + 1]);
                continue;
            }
            let first = node.next as usize;
            for corners in &self.triangles[first..first + node.count as usize] {
                if let Some((at_m, normal)) = meet(corners, origin, direction)
                    && let Some(normal) = Unit::try_new(normal, 1e-18)
                {
                    out.push(Crossing { at_m, normal });
                }
            }
        }
    }

    /// The first crossing in front of the origin.
    pub(crate) fn first(&self, origin: &Point3<f64>, direction: &Unit<Vector3<f64>>) -> Option<Crossing> {
        let mut all = Vec::new();
        self.crossings(origin, direction, &mut all);
        all.into_iter().filter(|c| c.at_m >= 0.0).min_by(|a, b| a.at_m.total_cmp(&b.at_m))
    }

    /// The solid parts of the whole line, in order. Shells may overlap: what is inside of any is solid. Where crossings do
    /// not add up (a line along a face, an open mesh) there are none.
    pub(crate) fn spans(&self, origin: &Point3<f64>, direction: &Unit<Vector3<f64>>) -> Vec<Span> {
        let mut all = Vec::new();
        self.crossings(origin, direction, &mut all);
        all.sort_by(|a, b| a.at_m.total_cmp(&b.at_m));
        let enters = |c: &Crossing| c.normal.dot(direction) < 0.0;
        all.dedup_by(|b, a| b.at_m - a.at_m < SAME_M && enters(a) == enters(b));
        let (mut depth, mut from, mut spans) = (0i32, None, Vec::new());
        for crossing in all {
            if enters(&crossing) {
                if depth == 0 {
                    from = Some(crossing);
                }
                depth += 1;
            } else {
                depth -= 1;
                if depth < 0 {
                    return Vec::new();
                }
                if depth == 0
                    && let Some(from) = from.take().filter(|f| crossing.at_m - f.at_m > LEAST_M)
                {
                    spans.push(Span { from, to: crossing });
                }
            }
        }
        if depth == 0 { spans } else { Vec::new() }
    }
}

/// Builds the tree of `triangles[start..end]`, halved by number along the longest side of their middles.
fn build(nodes: &mut Vec<Node>, triangles: &mut [[Point3<f64>; 3]], start: usize, end: usize) {
    let part = &mut triangles[start..end];
    let first = part[0][0];
    let corners = part.iter().flatten();
    let (low, high) = corners.fold((first, first), |(low, high), p| (low.inf(p), high.sup(p)));
    let at = nodes.len();
    let leaf = part.len() <= LEAF;
    let count = if leaf { part.len() as u32 } else { 0 };
    // A hair of room: a line along a side of a box is not to slip by.
    let room = Vector3::repeat(1e-9);
    nodes.push(Node { low: low - room, high: high + room, next: start as u32, count });
    if leaf {
        return;
    }
    let axis = (high - low).imax();
    let middle = |t: &[Point3<f64>; 3]| t[0][axis] + t[1][axis] + t[2][axis];
    let half = part.len() / 2;
    part.select_nth_unstable_by(half, |a, b| middle(a).total_cmp(&middle(b)));
    build(nodes, triangles, start, start + half);
    nodes[at].next = nodes.len() as u32;
    build(nodes, triangles, start + half, end);
}

/// Whether a whole line passes a node's box.
fn passes(node: &Node, origin: &Point3<f64>, inverse: &Vector3<f64>) -> bool {
    let (mut near, mut far) = (f64::NEG_INFINITY, f64::INFINITY);
    for a in 0..3 {
        let (x, y) = ((node.low[a] - origin[a]) * inverse[a], (node.high[a] - origin[a]) * inverse[a]);
        // Where a line lies in a side of the box one of both is no number, which max and min leave out.
        near = near.max(x.min(y));
        far = far.min(x.max(y));
    }
    near <= far
}

#[cfg(test)]
mod tests {
    use graspd_sim::object::{Kind, Object};
    use nalgebra::Isometry3;
    use proptest::prelude::*;

    use super::*;
    use crate::evaluate::ap::cast;

    #[test]
    fn a_line_through_two_overlapping_boxes_has_one_solid_part() {
        let mut mesh = Mesh::cuboid(Vector3::new(0.02, 0.03, 0.04));
        mesh.append(&Mesh::cuboid(Vector3::new(0.02, 0.01, 0.01)), &Isometry3::translation(0.03, 0.0, 0.0));
        mesh.append(&Mesh::cuboid(Vector3::repeat(0.01)), &Isometry3::translation(0.1, 0.0, 0.0));
        let lines = Lines::new(&mesh);
        let origin = Point3::new(0.0, 0.002, 0.003);
        let spans = lines.spans(&origin, &Vector3::x_axis());
        let ends: Vec<_> = spans.iter().map(|s| (s.from.at_m, s.to.at_m)).collect();
        assert_eq!(ends.len(), 2, "{ends:?}");
        for ((a, b), (c, d)) in ends.iter().zip([(-0.02, 0.05), (0.09, 0.11)]) {
            assert!((a - c).abs() < 1e-12 && (b - d).abs() < 1e-12, "{ends:?}");
        }
        assert!((spans[0].from.normal.x + 1.0).abs() < 1e-12 && (spans[0].to.normal.x - 1.0).abs() < 1e-12);
        // Through the diagonal of a face, which two triangles share.
        let diagonal = lines.spans(&Point3::new(0.1, 0.0, 0.0), &Vector3::z_axis());
        assert_eq!(diagonal.len(), 1);
        assert!(lines.spans(&Point3::new(0.0, 0.5, 0.0), &Vector3::x_axis()).is_empty());
    }

    #[test]
    fn an_empty_mesh_is_never_met() {
        let lines = Lines::new(&Mesh::default());
        assert_eq!(lines.first(&Point3::origin(), &Vector3::x_axis()), None);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]

        /// The tree finds what a look at every triangle finds.
        #[test]
        fn the_first_crossing_is_that_of_a_cast(
            kind in 0..Kind::ALL.len(),
            from in prop::array::uniform3(-0.2..0.2f64),
            to in prop::array::uniform3(-0.03..0.03f64),
        ) {
            let object = Object::sample(Kind::ALL[kind], 1);
            let (origin, to) = (Point3::from(from), Point3::from(to));
            prop_assume!((to - origin).norm() > 1e-3);
            let direction = Unit::new_normalize(to - origin);
            let found = Lines::new(&object.mesh).first(&origin, &direction);
            let expected = cast(&object.mesh, &Isometry3::identity(), &origin, &direction);
            prop_assert_eq!(found.map(|c| c.at_m), expected.map(|h| h.distance_m));
        }
    }
}
