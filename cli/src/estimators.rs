//! The contact estimators of this program: the geometric rule, the shipped network, and networks of the user's own.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context as _;
use clap::Args;
use graspd_inference::Network;
use graspd_planner::estimator::{ContactEstimator, Geometric, Learned};
use graspd_server::Estimators;

/// Which estimator finds the contacts.
#[derive(Debug, Clone, Default, Args)]
pub(crate) struct EstimatorArgs {
    /// Contact estimator: geometric, or learned
    #[arg(long, value_name = "NAME")]
    estimator: Option<String>,
    /// Network of one's own for the learned estimator, exported by graspd_train; one for each kind of volume. Makes
    /// the learned estimator the default
    #[arg(long, value_name = "ONNX")]
    model: Vec<PathBuf>,
}

impl EstimatorArgs {
    /// The name that was asked for, unless it is the default.
    pub(crate) fn name(&self) -> Option<&str> {
        self.estimator.as_deref()
    }

    /// True when networks were given.
    pub(crate) fn has_models(&self) -> bool {
        !self.model.is_empty()
    }

    /// All estimators, the chosen one first.
    ///
    /// # Errors
    /// For a model file that cannot be read or is not one of ours, and for an unknown name, with the known ones.
    pub(crate) fn all(&self) -> anyhow::Result<Estimators> {
        let learned: Arc<dyn ContactEstimator> = Arc::new(self.learned()?);
        let geometric: Arc<dyn ContactEstimator> = Arc::new(Geometric);
        let known = if self.has_models() { [learned, geometric] } else { [geometric, learned] };
        let chosen = match self.name() {
            None => 0,
            Some(name) => known.iter().position(|e| e.name() == name).with_context(|| {
                let names: Vec<&str> = known.iter().map(|e| e.name()).collect();
                format!("--estimator: found {name:?}, expected {}", names.join(" or "))
            })?,
        };
        let mut all = known.to_vec();
        all.swap(0, chosen);
        let first = all.remove(0);
        Ok(Estimators::new(first, all))
    }

    /// The chosen one.
    ///
    /// # Errors
    /// As [`EstimatorArgs::all`].
    pub(crate) fn chosen(&self) -> anyhow::Result<Arc<dyn ContactEstimator>> {
        Ok(self.all()?.get(None)?)
    }

    fn learned(&self) -> anyhow::Result<Learned> {
        let mut networks = self.model.iter().map(|path| network(path));
        let Some(first) = networks.next() else {
            return graspd_models::learned().context("the network that graspd ships");
        };
        Ok(Learned::new(first?, networks.collect::<anyhow::Result<_>>()?))
    }
}

/// The network in a file.
///
/// # Errors
/// For a file that cannot be read or is not one of ours.
pub(crate) fn network(path: &Path) -> anyhow::Result<Network> {
    let bytes = std::fs::read(path).with_context(|| format!("--model {}: cannot be read", path.display()))?;
    Network::from_bytes(&bytes).with_context(|| format!("--model {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Only {
        #[command(flatten)]
        estimators: EstimatorArgs,
    }

    fn of(flags: &str) -> EstimatorArgs {
        Only::parse_from(std::iter::once("graspd").chain(flags.split_whitespace())).estimators
    }

    fn names(flags: &str) -> Vec<String> {
        of(flags).all().unwrap().names().map(str::to_owned).collect()
    }

    #[test]
    fn the_asked_one_comes_first_and_the_others_stay() {
        assert_eq!(names(""), ["geometric", "learned"]);
        assert_eq!(names("--estimator learned"), ["learned", "geometric"]);
    }

    #[test]
    fn an_unknown_one_is_refused_with_the_known_ones() {
        let message = of("--estimator magic").all().unwrap_err().to_string();
        assert_eq!(message, "--estimator: found \"magic\", expected geometric or learned");
    }

    #[test]
    fn ones_own_network_is_read_and_becomes_the_default() {
        let path = std::env::temp_dir().join(format!("graspd-own-{}.onnx", std::process::id()));
        std::fs::write(&path, graspd_models::TSDF_QUATERNION).unwrap();
        assert_eq!(names(&format!("--model {}", path.display())), ["learned", "geometric"]);
        assert_eq!(
            names(&format!("--model {} --estimator geometric", path.display())),
            ["geometric", "learned"]
        );
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn a_damaged_network_and_a_foreign_file_are_told_apart() {
        let path = std::env::temp_dir().join(format!("graspd-other-{}.onnx", std::process::id()));
        let told = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            format!("{:#}", of(&format!("--model {}", path.display())).all().unwrap_err())
        };
        let mut damaged = graspd_models::TSDF_QUATERNION.to_vec();
        let middle = damaged.len() / 2;
        damaged[middle] ^= 1;
        assert!(told(&damaged).contains("the file is damaged"), "{}", told(&damaged));
        assert!(told(b"no network at all").contains("expected an ONNX file"));
        std::fs::remove_file(&path).unwrap();
        let missing = format!("{:#}", of("--model /nowhere/mine.onnx").all().unwrap_err());
        assert!(missing.starts_with("--model /nowhere/mine.onnx: cannot be read"), "{missing}");
    }
}
