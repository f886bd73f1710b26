//! How well a network finds contacts: E_Pc, E_Pe and E_Angle of Supplementary Note 2 over labelled views.
//!
//! Scores are probabilities of one event per voxel, so the divergence of a voxel is that of two Bernoulli distributions:
//! E_Pc and E_Pe are exp(-KL) averaged over all voxels. Nearly all voxels are empty, so these sit close to 1; the means
//! over labelled voxels alone stand beside them. E_Angle is the cosine between labelled and found inward directions,
//! weighted by the label's score. The trainer's `metrics.py` computes the same.

use graspd_inference::{Network, OrientationKind, Output, RunError, VolumeInput};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::table::Table;
use crate::dataset::sample::{ContactLabel, Sample};

/// Found probabilities are kept this far from 0 and 1, where a divergence would be infinite.
const NEVER_SURE: f64 = 1e-7;

/// Sums over views.
#[derive(Debug, Clone, Copy, Default)]
pub struct ContactMetrics {
    views: f64,
    contacts: f64,
    centroids: f64,
    likeness: [f64; 2],
    labelled: [f64; 2],
    cosine: f64,
    weight: f64,
}

/// Means over views, each at most 1; `None` where no view had a label.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ContactScores {
    /// Views.
    pub views: usize,
    /// E_Pc over all voxels.
    pub e_pc: Option<f64>,
    /// E_Pe over all voxels.
    pub e_pe: Option<f64>,
    /// E_Angle.
    pub e_angle: Option<f64>,
    /// E_Pc over voxels with a contact.
    pub e_pc_labelled: Option<f64>,
    /// E_Pe over voxels with a centroid.
    pub e_pe_labelled: Option<f64>,
}

impl ContactMetrics {
    /// Lets a network answer one view, and adds how good the answer is.
    ///
    /// # Errors
    /// [`RunError::Size`] when the view has another resolution than the network.
    pub fn add(&mut self, network: &Network, view: &Sample) -> Result<(), RunError> {
        let answer = answer(network, view)?;
        self.add_answer(&answer, network.info().volume, view);
        Ok(())
    }

    fn add_answer(&mut self, answer: &Output, kind: VolumeInput, view: &Sample) {
        let contacts: Vec<&ContactLabel> = match kind {
            VolumeInput::Tsdf => view.contacts.iter().collect(),
            VolumeInput::Occupancy => view.contacts_of_occupancy().collect(),
        };
        let scores = contacts.iter().map(|c| (c.index, c.score()));
        let (all, labelled) = likeness(&answer.certainty, scores);
        self.views += 1.0;
        self.likeness[0] += all;
        if let Some(labelled) = labelled {
            self.contacts += 1.0;
            self.labelled[0] += labelled;
        }
        let (all, labelled) = likeness(&answer.centroid, view.centroids.iter().map(|c| (c.index, c.score())));
        self.likeness[1] += all;
        if let Some(labelled) = labelled {
            self.centroids += 1.0;
            self.labelled[1] += labelled;
        }
        for contact in contacts {
            let found = Vector3::from(answer.orientation.inward(contact.index as usize)).cast::<f64>();
            let weight = f64::from(contact.score());
            self.cosine += weight * found.dot(&contact.inward());
            self.weight += weight;
        }
    }

    /// Sums of both.
    #[must_use]
    pub fn and(&self, other: &Self) -> Self {
        let pair = |a: [f64; 2], b: [f64; 2]| [a[0] + b[0], a[1] + b[1]];
        Self {
            views: self.views + other.views,
            contacts: self.contacts + other.contacts,
            centroids: self.centroids + other.centroids,
            likeness: pair(self.likeness, other.likeness),
            labelled: pair(self.labelled, other.labelled),
            cosine: self.cosine + other.cosine,
            weight: self.weight + other.weight,
        }
    }

    /// The means.
    pub fn scores(&self) -> ContactScores {
        let over = |sum: f64, count: f64| (count > 0.0).then(|| sum / count);
        ContactScores {
            views: self.views as usize,
            e_pc: over(self.likeness[0], self.views),
            e_pe: over(self.likeness[1], self.views),
            e_angle: over(self.cosine, self.weight),
            e_pc_labelled: over(self.labelled[0], self.contacts),
            e_pe_labelled: over(self.labelled[1], self.centroids),
        }
    }
}

/// What a network says of a view.
///
/// # Errors
/// [`RunError::Size`] when the view has another resolution than the network.
pub fn answer(network: &Network, view: &Sample) -> Result<Output, RunError> {
    network.run(&input(view, network.info().volume))
}

/// The volume that a network of that kind reads.
fn input(view: &Sample, kind: VolumeInput) -> Vec<f32> {
    match kind {
        VolumeInput::Tsdf => view.tsdf.iter().map(|&code| f32::from(code) / 255.0).collect(),
        VolumeInput::Occupancy => {
            (0..view.tsdf.len()).map(|i| if view.is_occupied(i) { 1.0 } else { 0.0 }).collect()
        }
    }
}

/// Mean of exp(-KL) over all voxels, and over the labelled ones.
fn likeness(found: &[f32], labels: impl Iterator<Item = (u32, f32)>) -> (f64, Option<f64>) {
    let mut sum: f64 = found.iter().map(|&q| alike(0.0, f64::from(q))).sum();
    let (mut labelled, mut count) = (0.0, 0.0);
    for (index, score) in labels {
        let Some(&q) = found.get(index as usize) else { continue };
        let here = alike(f64::from(score), f64::from(q));
        sum += here - alike(0.0, f64::from(q));
        labelled += here;
        count += 1.0;
    }
    (sum / found.len().max(1) as f64, (count > 0.0).then(|| labelled / count))
}

/// exp(-KL(p‖q)) of two Bernoulli distributions.
fn alike(p: f64, q: f64) -> f64 {
    let q = q.clamp(NEVER_SURE, 1.0 - NEVER_SURE);
    let term = |p: f64, q: f64| if p > 0.0 { p * (p / q).ln() } else { 0.0 };
    (-(term(p, q) + term(1.0 - p, 1.0 - q)).max(0.0)).exp()
}

/// What was measured of several networks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ContactReport {
    /// What was measured, one condition a line.
    pub conditions: Vec<String>,
    /// A row for each network.
    pub rows: Vec<ContactRow>,
}

/// What was measured of one network.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ContactRow {
    /// Name of the network.
    pub network: String,
    /// `TSDF` or `Voxel`, and `Quaternion` or `R6D`, as the paper calls them.
    pub data_type: String,
    /// The means.
    pub scores: ContactScores,
}

impl ContactRow {
    /// A row of the table.
    pub fn new(name: &str, network: &Network, scores: ContactScores) -> Self {
        let volume = match network.info().volume {
            VolumeInput::Tsdf => "TSDF",
            VolumeInput::Occupancy => "Voxel",
        };
        let orientation = match network.info().orientation {
            OrientationKind::Quaternion => "Quaternion",
            OrientationKind::R6d => "R6D",
        };
        Self { network: name.to_owned(), data_type: format!("{volume}-{orientation}"), scores }
    }
}

impl ContactReport {
    fn table(&self) -> Table {
        let mut table = Table::new([
            "network",
            "data type",
            "views",
            "E_Pc",
            "E_Pe",
            "E_Angle",
            "E_Pc labelled",
            "E_Pe labelled",
        ]);
        let shown = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |v| format!("{v:.4}"));
        for row in &self.rows {
            let s = &row.scores;
            table.row([
                row.network.clone(),
                row.data_type.clone(),
                s.views.to_string(),
                shown(s.e_pc),
                shown(s.e_pe),
                shown(s.e_angle),
                shown(s.e_pc_labelled),
                shown(s.e_pe_labelled),
            ]);
        }
        table
    }

    /// For a terminal.
    pub fn text(&self) -> String {
        format!("{}\n\n{}", self.conditions.join("\n"), self.table().text())
    }

    /// For a document.
    pub fn markdown(&self) -> String {
        let conditions: String = self.conditions.iter().map(|c| format!("- {c}\n")).collect();
        format!("{conditions}\n{}", self.table().markdown())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn likeness_is_exp_of_minus_the_divergence() {
        assert!((alike(0.3, 0.3) - 1.0).abs() < 1e-12);
        // KL(1‖q) = -ln q, KL(0‖q) = -ln(1 - q).
        assert!((alike(1.0, 0.25) - 0.25).abs() < 1e-12);
        assert!((alike(0.0, 0.25) - 0.75).abs() < 1e-12);
        let by_hand = (0.6_f64 * (0.6_f64 / 0.2).ln() + 0.4 * (0.4_f64 / 0.8).ln()).exp().recip();
        assert!((alike(0.6, 0.2) - by_hand).abs() < 1e-12);
        assert!(alike(1.0, 0.0) > 0.0 && alike(0.0, 1.0) > 0.0, "never sure");
    }

    #[test]
    fn labelled_voxels_count_among_all_and_alone() {
        let found = [0.0, 0.5, 0.0, 0.0];
        let (all, labelled) = likeness(&found, [(1, 1.0)].into_iter());
        assert!((all - (3.0 + 0.5) / 4.0).abs() < 1e-6);
        assert!((labelled.unwrap() - 0.5).abs() < 1e-12);
        let (all, labelled) = likeness(&found, std::iter::empty());
        assert!((all - (3.0 + 0.5) / 4.0).abs() < 1e-6 && labelled.is_none());
    }

    #[test]
    fn no_view_has_no_mean() {
        let scores = ContactMetrics::default().scores();
        assert_eq!((scores.views, scores.e_pc, scores.e_angle), (0, None, None));
    }
}
