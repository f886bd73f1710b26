//! The contact dataset: cluttered scenes seen from all around, every view labelled with where fingers may touch.
//!
//! A scene is drawn and settled ([`clutter`]); on its objects antipodal grasps are sampled ([`antipodal`]), checked for
//! collision ([`surroundings`]) and decomposed into contacts and centroids in the world frame ([`contacts`]): once for all
//! views. A view is a noisy depth frame ([`view`]), cleaned, placed and fused by the planner's own code, on whose voxels the
//! contacts are averaged ([`voxels`], [`average`]) as Supplementary Note 1 and the reference implementation describe.
//!
//! The files are described in `docs/dataset.md`; [`shard`] writes them, [`read`] reads them. No file is opened here: callers
//! bring readers and writers.

// How a scene comes about.
pub mod clutter;
pub mod families;
pub mod recipe;
pub mod view;

// How it is labelled.
pub mod antipodal;
pub mod average;
pub mod contacts;
mod lines;
pub mod surroundings;
pub mod voxels;

// How it is kept.
pub mod read;
pub mod sample;
pub mod shard;

// What is done with it.
pub mod generate;
pub mod oracle;
pub(crate) mod panel;
pub mod picture;
pub mod stats;

#[cfg(test)]
mod tests;

/// Why data cannot be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DatasetError {
    /// A setting is of no use.
    #[error("{field}: found {found}, expected {expected}")]
    Setting {
        /// The setting.
        field: &'static str,
        /// Found value.
        found: String,
        /// What is expected.
        expected: String,
    },
    /// The objects of a scene find no place, however few they are.
    #[error("scene {scene}: {source}")]
    Arrange {
        /// Number of the scene.
        scene: u32,
        /// What found no place.
        source: graspd_sim::clutter::ArrangeError,
    },
    /// The planner cannot read a frame.
    #[error("the planner cannot read a frame")]
    Frame(#[from] graspd_planner::scene::SceneError),
    /// The system gives no threads.
    #[error("no threads")]
    Threads(#[from] rayon::ThreadPoolBuildError),
    /// A shard cannot be written.
    #[error("the shard cannot be written")]
    Write(#[from] std::io::Error),
    /// A shard that is to be continued cannot be read.
    #[error(transparent)]
    Read(#[from] read::ReadError),
}
