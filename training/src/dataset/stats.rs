//! Statistics of a dataset, and bounds that tell a sane one from one that was made wrongly.

use std::f64::consts::TAU;
use std::fmt::Write as _;

use graspd_planner::grid::Grid;
use serde::Serialize;

use super::sample::{OCCUPIED, Sample};

/// Bins of scores from 0 to 1.
const BINS: usize = 10;
/// Sectors of level directions.
const SECTORS: usize = 12;
/// With fewer views nothing is said about shares.
const LEAST_VIEWS: usize = 32;

/// What samples hold, counted.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Stats {
    /// Views.
    pub views: usize,
    /// Scenes that they are of.
    pub scenes: usize,
    /// Views without a contact.
    pub without_contacts: usize,
    /// Views in which no surface was seen.
    pub without_surface: usize,
    /// Contacts.
    pub contacts: usize,
    /// Those that the occupancy volume leaves.
    pub contacts_of_occupancy: usize,
    /// Contacts in voxels that the TSDF shows occupied.
    pub contacts_in_occupied: usize,
    /// Contacts with a voxel of a seen surface among the 124 around them. Flanks that no ray touched have none.
    pub contacts_at_surface: usize,
    /// Centroids.
    pub centroids: usize,
    /// Contacts by score, from 0 to 1.
    pub scores: [usize; BINS],
    /// Centroids by score.
    pub centroid_scores: [usize; BINS],
    /// Contacts whose inward direction is level within 45°, by sector about the vertical from x on.
    pub level: [usize; SECTORS],
    /// Contacts that press down within 45°.
    pub down: usize,
    /// Contacts that press up within 45°.
    pub up: usize,
    /// Voxels of surfaces that were seen.
    pub occupied: usize,
    /// Voxels.
    pub voxels: usize,
    #[serde(skip)]
    last_scene: Option<u32>,
}

impl Stats {
    /// Counts a sample; the views of a scene come together.
    pub fn add(&mut self, sample: &Sample) {
        self.views += 1;
        if self.last_scene.replace(sample.scene) != Some(sample.scene) {
            self.scenes += 1;
        }
        let occupied = sample.tsdf.iter().filter(|v| OCCUPIED.contains(v)).count();
        self.occupied += occupied;
        self.voxels += sample.tsdf.len();
        self.without_surface += usize::from(occupied == 0);
        self.without_contacts += usize::from(sample.contacts.is_empty());
        self.contacts += sample.contacts.len();
        self.contacts_of_occupancy += sample.contacts_of_occupancy().count();
        self.centroids += sample.centroids.len();
        let bin = |score: f32| ((score * BINS as f32) as usize).min(BINS - 1);
        for contact in &sample.contacts {
            let value = sample.tsdf.get(contact.index as usize).copied().unwrap_or(0);
            self.contacts_in_occupied += usize::from(OCCUPIED.contains(&value));
            self.contacts_at_surface += usize::from(is_near_surface(sample, contact.index as usize));
            self.scores[bin(contact.score())] += 1;
            let inward = contact.inward();
            if inward.z.abs() <= std::f64::consts::FRAC_1_SQRT_2 {
                let turn = inward.y.atan2(inward.x).rem_euclid(TAU) / TAU;
                self.level[((turn * SECTORS as f64) as usize).min(SECTORS - 1)] += 1;
            } else if inward.z < 0.0 {
                self.down += 1;
            } else {
                self.up += 1;
            }
        }
        for centroid in &sample.centroids {
            self.centroid_scores[bin(centroid.score())] += 1;
        }
    }

    /// What is not as it should be; nothing for a sane dataset.
    pub fn complaints(&self) -> Vec<String> {
        let mut out = Vec::new();
        let mut expect = |what: &str, found: f64, low: f64, high: f64| {
            // Also complains of what is no number.
            if !(low..=high).contains(&found) {
                out.push(format!("{what}: found {found:.3}, expected {low} to {high}"));
            }
        };
        expect("views", self.views as f64, 1.0, f64::INFINITY);
        expect("contacts in occupied voxels", self.contacts_in_occupied as f64, 0.0, 0.0);
        if self.views < LEAST_VIEWS {
            return out;
        }
        let share = |part: usize, of: usize| part as f64 / of.max(1) as f64;
        expect("share of views without a surface", share(self.without_surface, self.views), 0.0, 0.02);
        expect("share of views without contacts", share(self.without_contacts, self.views), 0.0, 0.25);
        expect("contacts in a view", share(self.contacts, self.views), 50.0, 50_000.0);
        expect("contacts for each centroid", share(self.contacts, self.centroids), 1.0, 10.0);
        let near = share(self.contacts_at_surface, self.contacts);
        expect("share of contacts within two voxels of a seen surface", near, 0.4, 1.0);
        let left = share(self.contacts_of_occupancy, self.contacts);
        expect("share of contacts left by the occupancy volume", left, 0.1, 1.0);
        let high = share(self.scores[BINS / 2..].iter().sum(), self.contacts);
        expect("share of contacts that score at least 0.5", high, 0.5, 1.0);
        let level: usize = self.level.iter().sum();
        expect("share of level contacts", share(level, self.contacts), 0.3, 1.0);
        let rarest = self.level.iter().min().copied().unwrap_or(0);
        expect(
            "level directions: the rarest sector against an even share",
            share(rarest * SECTORS, level),
            0.3,
            1.0,
        );
        out
    }

    /// The statistics as text.
    pub fn text(&self) -> String {
        let per = |part: usize, of: usize| part as f64 / of.max(1) as f64;
        let percent = |part: usize, of: usize| 100.0 * per(part, of);
        let bars = |counts: &[usize]| {
            let all: usize = counts.iter().sum();
            counts.iter().map(|&c| format!("{:5.1}", percent(c, all))).collect::<Vec<_>>().join(" ")
        };
        let mut out = String::new();
        let mut line = |name: &str, value: String| {
            // Writing into a string does not fail.
            let _ = writeln!(out, "{name:<42} {value}");
        };
        line("scenes, views", format!("{}, {}", self.scenes, self.views));
        line("views without a contact, %", format!("{:.1}", percent(self.without_contacts, self.views)));
        line("views without a surface, %", format!("{:.1}", percent(self.without_surface, self.views)));
        line("surface voxels of a view, %", format!("{:.2}", percent(self.occupied, self.voxels)));
        line("contacts of a view", format!("{:.0}", per(self.contacts, self.views)));
        line(
            "  left by the occupancy volume, %",
            format!("{:.1}", percent(self.contacts_of_occupancy, self.contacts)),
        );
        line(
            "  within 2 voxels of a seen surface, %",
            format!("{:.1}", percent(self.contacts_at_surface, self.contacts)),
        );
        line("  in occupied voxels", self.contacts_in_occupied.to_string());
        line("centroids of a view", format!("{:.0}", per(self.centroids, self.views)));
        line("contacts for each centroid", format!("{:.2}", per(self.contacts, self.centroids)));
        line("contact scores 0 to 1, % in tenths", bars(&self.scores));
        line("centroid scores 0 to 1, % in tenths", bars(&self.centroid_scores));
        line("level contacts by direction, % in 30°", bars(&self.level));
        line("level, down, up, %", bars(&[self.level.iter().sum(), self.down, self.up]));
        out
    }
}

/// Whether a voxel of a seen surface is within two voxels along each axis.
fn is_near_surface(sample: &Sample, index: usize) -> bool {
    let grid = Grid { resolution: sample.resolution as usize, size_m: 1.0 };
    let [xs, ys, zs] = grid.voxel(index).map(|c| c.saturating_sub(2)..(c + 3).min(grid.resolution));
    xs.into_iter().any(|x| {
        ys.clone().any(|y| {
            let start = grid.index(x, y, 0);
            sample.tsdf[start + zs.start..start + zs.end].iter().any(|v| OCCUPIED.contains(v))
        })
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::super::sample::{CentroidLabel, ContactLabel};
    use super::super::view::Preview;
    use super::*;

    /// A view in which `count` contacts press in as many directions all around, all in free voxels at a surface.
    fn view(scene: u32, count: u32) -> Sample {
        let voxels = 512;
        let inward = |k: u32| {
            let turn = TAU * (f64::from(k) + 0.5) / f64::from(count);
            UnitQuaternion::rotation_between(&Vector3::z(), &Vector3::new(turn.cos(), turn.sin(), 0.0))
                .unwrap()
        };
        Sample {
            scene,
            view: 0,
            resolution: 8,
            world_from_volume: [0.0; 16],
            world_from_camera: [0.0; 16],
            table_m: 0.1,
            // A surface in every eighth voxel, between the contacts.
            tsdf: (0..voxels).map(|i| if i >= 400 || i % 8 == 3 { 120 } else { 140 }).collect(),
            occupancy: (0..voxels / 8).map(|i| if i < 50 { 0 } else { 255 }).collect(),
            contacts: (0..count)
                .filter_map(|k| {
                    ContactLabel::new(k / 6 * 8 + [0, 1, 2, 4, 5, 6][k as usize % 6], 0.9, &inward(k))
                })
                .collect(),
            centroids: (0..count / 4).filter_map(|k| CentroidLabel::new(k, 0.9)).collect(),
            preview: Preview::default(),
        }
    }

    fn of(samples: impl Iterator<Item = Sample>) -> Stats {
        let mut stats = Stats::default();
        samples.for_each(|s| stats.add(&s));
        stats
    }

    #[test]
    fn a_sane_dataset_is_not_complained_of() {
        let stats = of((0..64).map(|i| view(i / 4, 240)));
        assert_eq!(stats.complaints(), Vec::<String>::new());
        assert_eq!((stats.views, stats.scenes, stats.contacts), (64, 16, 64 * 240));
        assert_eq!(stats.scores[9], stats.contacts);
        assert!(stats.level.iter().all(|&n| n == 64 * 20), "{:?}", stats.level);
        assert!(stats.text().contains("contacts for each centroid                 4.00"), "{}", stats.text());
    }

    #[test]
    fn each_fault_is_named() {
        let named = |stats: Stats, what: &str| {
            let complaints = stats.complaints();
            assert!(complaints.iter().any(|c| c.starts_with(what)), "{what}: {complaints:?}");
        };
        named(Stats::default(), "views");
        named(
            of((0..64).map(|i| view(i, if i % 2 == 0 { 0 } else { 240 }))),
            "share of views without contacts",
        );
        let with = |change: &dyn Fn(&mut Sample)| {
            of((0..64).map(|i| {
                let mut sample = view(i, 240);
                change(&mut sample);
                sample
            }))
        };
        named(with(&|s| s.tsdf[0] = 100), "contacts in occupied voxels");
        named(with(&|s| s.tsdf.fill(0)), "share of views without a surface");
        named(with(&|s| s.tsdf[..500].fill(200)), "share of contacts within");
        named(with(&|s| s.occupancy.fill(255)), "share of contacts left");
        named(with(&|s| s.contacts.iter_mut().for_each(|c| c.score = 20)), "share of contacts that score");
        named(with(&|s| s.contacts.truncate(100)), "level directions");
        named(with(&|s| s.centroids.clear()), "contacts for each centroid");
        let up = [0, 0, 0, 32767];
        named(with(&|s| s.contacts.iter_mut().for_each(|c| c.orientation = up)), "share of level contacts");
    }
}
