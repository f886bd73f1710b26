//! The objects of an evaluation: procedural families, or a folder of meshes.

use std::sync::Arc;

use clap::Args;
use graspd_hands::library;
use graspd_sim::object::Object;
use graspd_training::evaluate::draw;

/// The hands of Supplementary Table 4: the narrowest of them decides how wide procedural objects may be.
const TABLE_HANDS: [&str; 7] =
    ["finray-2f", "robotiq-2f85", "robotiq-3f", "model-o", "finray-4f", "brunel", "leap"];

/// Which objects are grasped.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Objects")]
pub(crate) struct ObjectArgs {
    /// Objects must fit a hand that opens this far, millimetres; the narrowest of the paper's seven if left out
    #[arg(long, value_name = "MM", value_parser = clap::value_parser!(u32).range(30..=500))]
    opening: Option<u32>,
}

impl ObjectArgs {
    /// `count` objects, and what to say about them.
    ///
    /// # Errors
    /// For an opening that nothing fits.
    pub(crate) fn objects(&self, count: usize, seed: u64) -> anyhow::Result<(Vec<Arc<Object>>, String)> {
        let opening_m = self.opening.map_or_else(narrowest_m, |mm| f64::from(mm) / 1e3);
        let objects = draw(count, opening_m, seed);
        anyhow::ensure!(
            objects.len() == count,
            "--opening: found {:.0} mm, expected more: only {} of {count} objects fit",
            opening_m * 1e3,
            objects.len()
        );
        let about = format!(
            "{count} procedural objects, the same for every hand, none wider than 10 mm less than {:.0} mm and \
             none thinner than 20 mm",
            opening_m * 1e3
        );
        Ok((objects, about))
    }
}

/// How far the narrowest hand of the table opens, metres.
fn narrowest_m() -> f64 {
    let openings = TABLE_HANDS.iter().filter_map(|id| library::hand(id)?.opening).map(|o| o.max_m);
    openings.fold(f64::INFINITY, f64::min)
}
