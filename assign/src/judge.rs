//! What each grasp is worth, and why some cannot be taken whatever the others do.

use std::sync::Arc;

use crate::problem::{Arm, Grasp, KeepOut, Problem, Reach, Settings};
use crate::reason::{Cause, Rejected};
use crate::swept::Swept;
use crate::volume::corridor;

/// What a grasp's value is made of, each 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Factors {
    /// The planner's score.
    pub score: f64,
    /// How well the object's size suits the hand: [`size_suitability`].
    pub size: f64,
    /// How comfortably the arm reaches it.
    pub reach: f64,
}

impl Factors {
    /// Expected success: the product.
    pub fn value(&self) -> f64 {
        self.score * self.size * self.reach
    }
}

/// How well an object that is `width_m` wide suits a hand that takes widths from `min_m` to `max_m`: 1 up to three quarters of
/// its opening, then less (objects close to the maximal span fail by collisions, Supplementary Fig. 8c), 0 from its
/// opening on. What is less than a quarter of the opening is left to smaller hands where there are any: 0.75 for the smallest.
pub fn size_suitability(width_m: f64, (min_m, max_m): (f64, f64)) -> f64 {
    if width_m.is_nan() || width_m >= max_m || width_m < min_m {
        return 0.0;
    }
    let share = width_m / max_m;
    if share > 0.75 {
        1.0 - 0.7 * (share - 0.75) / 0.25
    } else if share < 0.25 {
        0.75 + share
    } else {
        1.0
    }
}

/// A grasp that can be taken.
#[derive(Debug)]
pub(crate) struct Candidate {
    pub(crate) arm: usize,
    pub(crate) grasp: usize,
    pub(crate) factors: Factors,
    pub(crate) value: f64,
    pub(crate) corridor: Arc<Swept>,
}

/// All grasps, looked at each by itself.
#[derive(Debug)]
pub(crate) struct Judged<'a> {
    pub(crate) problem: &'a Problem<'a>,
    settings: &'a Settings,
    /// Candidates of all arms, one arm after the other, best first.
    pub(crate) candidates: Vec<Candidate>,
    /// Place of each arm's candidates.
    pub(crate) of_arm: Vec<std::ops::Range<usize>>,
    /// Grasps that cannot be taken, of each arm.
    pub(crate) rejected: Vec<Vec<Rejected>>,
    /// Candidates that the search does not look at.
    pub(crate) left_out: usize,
}

impl Judged<'_> {
    fn key(&self, candidate: usize) -> &Grasp {
        let c = &self.candidates[candidate];
        &self.problem.arms[c.arm].grasps[c.grasp]
    }

    pub(crate) fn same_object(&self, a: usize, b: usize) -> bool {
        self.key(a).object.is_same(&self.key(b).object, self.settings.same_object_m)
    }

    pub(crate) fn corridors_conflict(&self, a: usize, b: usize) -> bool {
        let (a, b) = (&self.candidates[a], &self.candidates[b]);
        a.corridor.is_near(&b.corridor, self.settings.clearance_m)
    }
}

/// Looks at every grasp.
pub(crate) fn judge<'a>(problem: &'a Problem<'a>, settings: &'a Settings) -> Judged<'a> {
    let mut judged = Judged {
        problem,
        settings,
        candidates: Vec::new(),
        of_arm: Vec::with_capacity(problem.arms.len()),
        rejected: Vec::with_capacity(problem.arms.len()),
        left_out: 0,
    };
    for (at, arm) in problem.arms.iter().enumerate() {
        let (mut good, mut rejected) = (Vec::new(), Vec::new());
        for (index, grasp) in arm.grasps.iter().enumerate() {
            match look(problem, arm, grasp, settings) {
                Ok((factors, corridor)) => {
                    good.push(Candidate { arm: at, grasp: index, factors, value: factors.value(), corridor })
                }
                Err(cause) => rejected.push(Rejected { grasp: index, cause }),
            }
        }
        // Stable: of equals the planner's order stands.
        good.sort_by(|a, b| b.value.total_cmp(&a.value));
        judged.left_out += trim(arm, &mut good, settings);
        let begin = judged.candidates.len();
        judged.candidates.extend(good);
        judged.of_arm.push(begin..judged.candidates.len());
        judged.rejected.push(rejected);
    }
    judged
}

/// One grasp by itself.
fn look(
    problem: &Problem<'_>,
    arm: &Arm,
    grasp: &Grasp,
    settings: &Settings,
) -> Result<(Factors, Arc<Swept>), Cause> {
    if let Some(why) = &grasp.barred {
        return Err(Cause::Barred(why.clone()));
    }
    let near = |t: &&crate::Taken| t.object.is_same(&grasp.object, settings.same_object_m);
    if let Some(taken) = problem.taken.iter().find(near) {
        return Err(Cause::Taken { by: taken.by.clone() });
    }
    let size = match (grasp.width_m, arm.opening_m) {
        (Some(width), Some(opening)) => size_suitability(width, opening),
        _ => 1.0,
    };
    if size <= 0.0 {
        let (width_m, opening_m) = (grasp.width_m.unwrap_or(0.0), arm.opening_m.unwrap_or((0.0, 0.0)));
        return Err(Cause::Size { width_m, opening_m });
    }
    let reach = match &grasp.reach {
        Reach::Unknown => arm.region.reach(&grasp.world_from_hand.translation.vector),
        known => known.clone(),
    };
    let reach = match reach {
        Reach::Within(share) => share.clamp(0.0, 1.0),
        Reach::Beyond(why) => return Err(Cause::OutOfReach(why)),
        Reach::Unknown => 1.0,
    };
    let factors = Factors { score: grasp.score.clamp(0.0, 1.0), size, reach };
    let value = factors.value();
    if value.is_nan() || value < settings.least_value {
        return Err(Cause::Worthless { value });
    }
    let made =
        || Arc::new(Swept::new(corridor(&grasp.world_from_pregrasp, &grasp.world_from_hand, &arm.body)));
    let corridor = grasp.corridor.clone().unwrap_or_else(made);
    // What cannot be compared cannot be shown to be free.
    if !corridor.is_valid() {
        return Err(Cause::OutOfReach("its corridor is no volume".to_owned()));
    }
    let in_keep_out = |k: &&KeepOut| k.volume.is_near(corridor.capsules(), settings.clearance_m);
    if let Some(keep) = arm.keep_out.iter().find(in_keep_out) {
        return Err(Cause::KeepOut { name: keep.name.clone() });
    }
    let met = problem.occupied.iter().find(|other| corridor.is_near(&other.space, settings.clearance_m));
    if let Some(other) = met {
        return Err(Cause::Occupied { by: other.by.clone() });
    }
    Ok((factors, corridor))
}

/// Grasps of one object that are kept before others of it fill up what is left.
const OF_EACH_OBJECT: usize = 8;

/// Keeps the best of too many grasps, some of each object; how many were left out.
fn trim(arm: &Arm, good: &mut Vec<Candidate>, settings: &Settings) -> usize {
    let most = settings.grasps_per_arm.max(1);
    if good.len() <= most {
        return 0;
    }
    let all = std::mem::take(good);
    let count = all.len();
    let (mut first, mut rest) = (Vec::new(), Vec::new());
    for candidate in all {
        let object = &arm.grasps[candidate.grasp].object;
        let same = |c: &&Candidate| arm.grasps[c.grasp].object.is_same(object, settings.same_object_m);
        let known = first.iter().filter(same).count();
        if known < OF_EACH_OBJECT && first.len() < most {
            first.push(candidate)
        } else {
            rest.push(candidate)
        }
    }
    let room = most - first.len();
    first.extend(rest.into_iter().take(room));
    first.sort_by(|a, b| b.value.total_cmp(&a.value).then(a.grasp.cmp(&b.grasp)));
    *good = first;
    count - good.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_hands_get_the_papers_objects() {
        // Supplementary Note 7, Task 3: openings of 0.085 m and 0.155 m.
        let (small, wide) = ((0.0, 0.085), (0.0, 0.155));
        for width in [0.09, 0.11, 0.14] {
            assert_eq!(size_suitability(width, small), 0.0);
            assert!(size_suitability(width, wide) > 0.0);
        }
        assert!(size_suitability(0.03, small) > size_suitability(0.03, wide));
        assert!(size_suitability(0.08, wide) > size_suitability(0.08, small));
        assert_eq!(size_suitability(f64::NAN, wide), 0.0);
    }
}
