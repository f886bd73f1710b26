//! The space that a way sweeps: many capsules, and boxes around groups of them, so that two ways are soon told apart.

use nalgebra::{Point3, Vector3};

use crate::volume::Capsule;

/// A group of so few is not split.
const FEW: usize = 4;

/// An axis-aligned box around the capsules of a range.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Node {
    low: Vector3<f64>,
    high: Vector3<f64>,
    begin: usize,
    end: usize,
    /// The two halves; `None` for a group that is not split.
    halves: Option<(usize, usize)>,
}

impl Node {
    fn is_apart(&self, other: &Self, clearance_m: f64) -> bool {
        (0..3).any(|i| self.low[i] > other.high[i] + clearance_m || other.low[i] > self.high[i] + clearance_m)
    }

    fn size(&self) -> f64 {
        (self.high - self.low).sum()
    }
}

/// Capsules that are compared with others again and again.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Swept {
    capsules: Vec<Capsule>,
    /// The first is around all; none where there are no capsules.
    nodes: Vec<Node>,
}

impl Swept {
    /// Space in some order of its own.
    pub fn new(mut capsules: Vec<Capsule>) -> Self {
        let mut nodes = Vec::with_capacity(2 * capsules.len() / FEW + 1);
        if !capsules.is_empty() {
            let end = capsules.len();
            split(&mut capsules, 0, end, &mut nodes);
        }
        Self { capsules, nodes }
    }

    /// The capsules, in no order.
    pub fn capsules(&self) -> &[Capsule] {
        &self.capsules
    }

    /// True when all of it can be compared: see [`Capsule::is_valid`].
    pub fn is_valid(&self) -> bool {
        self.capsules.iter().all(Capsule::is_valid)
    }

    /// True when less than `clearance_m` is left to some of the other; never for nothing.
    pub fn is_near(&self, other: &Self, clearance_m: f64) -> bool {
        if self.nodes.is_empty() || other.nodes.is_empty() {
            return false;
        }
        let mut open = vec![(0, 0)];
        while let Some((a, b)) = open.pop() {
            let (mine, theirs) = (&self.nodes[a], &other.nodes[b]);
            if mine.is_apart(theirs, clearance_m) {
                continue;
            }
            match (mine.halves, theirs.halves) {
                (None, None) => {
                    let others = &other.capsules[theirs.begin..theirs.end];
                    let near = |x: &Capsule| others.iter().any(|y| x.distance(y) < clearance_m);
                    if self.capsules[mine.begin..mine.end].iter().any(near) {
                        return true;
                    }
                }
                // The larger one is split: the boxes become alike.
                (Some((first, second)), _) if theirs.halves.is_none() || mine.size() >= theirs.size() => {
                    open.extend([(first, b), (second, b)]);
                }
                (_, Some((first, second))) => open.extend([(a, first), (a, second)]),
                (Some((first, second)), None) => open.extend([(first, b), (second, b)]),
            }
        }
        false
    }
}

fn middle(capsule: &Capsule, axis: usize) -> f64 {
    nalgebra::center(&capsule.a, &capsule.b)[axis]
}

/// Puts a box around a range and its halves; its place among the nodes.
fn split(capsules: &mut [Capsule], begin: usize, end: usize, nodes: &mut Vec<Node>) -> usize {
    let mut low = Vector3::repeat(f64::INFINITY);
    let mut high = Vector3::repeat(f64::NEG_INFINITY);
    let (mut least, mut most) = (low, high);
    for capsule in &capsules[begin..end] {
        let grown = |p: &Point3<f64>, by: f64| p.coords.add_scalar(by);
        for p in [&capsule.a, &capsule.b] {
            low = low.inf(&grown(p, -capsule.radius_m));
            high = high.sup(&grown(p, capsule.radius_m));
        }
        let at = nalgebra::center(&capsule.a, &capsule.b).coords;
        (least, most) = (least.inf(&at), most.sup(&at));
    }
    let place = nodes.len();
    nodes.push(Node { low, high, begin, end, halves: None });
    if end - begin > FEW {
        let axis = (most - least).imax();
        let half = (end - begin) / 2;
        capsules[begin..end].select_nth_unstable_by(half, |a, b| middle(a, axis).total_cmp(&middle(b, axis)));
        let first = split(capsules, begin, begin + half, nodes);
        let second = split(capsules, begin + half, end, nodes);
        nodes[place].halves = Some((first, second));
    }
    place
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn capsules() -> impl Strategy<Value = Vec<Capsule>> {
        let point = || prop::array::uniform3(-1.0..1.0f64).prop_map(Point3::from);
        let one = (point(), prop::array::uniform3(-0.2..0.2f64), 0.0..0.1f64);
        let made = one.prop_map(|(a, d, radius_m)| Capsule { a, b: a + Vector3::from(d), radius_m });
        prop::collection::vec(made, 0..40)
    }

    proptest! {
        #[test]
        fn boxes_change_no_answer(a in capsules(), b in capsules(), clearance_m in 0.0..0.1f64) {
            let expected = a.iter().any(|x| b.iter().any(|y| x.distance(y) < clearance_m));
            let (swept, other) = (Swept::new(a.clone()), Swept::new(b));
            prop_assert_eq!(swept.is_near(&other, clearance_m), expected);
            prop_assert_eq!(other.is_near(&swept, clearance_m), expected);
            prop_assert_eq!(swept.capsules().len(), a.len());
        }
    }

    #[test]
    fn what_is_no_number_is_told_and_meets_nobody_by_accident() {
        let far = Capsule { a: Point3::new(f64::NAN, 0.0, 0.0), b: Point3::origin(), radius_m: 0.1 };
        assert!(!Swept::new(vec![far; 9]).is_valid());
        assert!(Swept::new(Vec::new()).is_valid());
    }
}
