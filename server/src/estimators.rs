//! The contact estimators of a server by name.

use std::sync::Arc;

use graspd_planner::estimator::{ContactEstimator, Geometric};

use crate::convert::shortened;
use crate::error::ServiceError;

/// Estimators by name; the first is the default.
#[derive(Clone)]
pub struct Estimators(Vec<Arc<dyn ContactEstimator>>);

impl std::fmt::Debug for Estimators {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_list().entries(self.0.iter().map(|e| e.name())).finish()
    }
}

impl Default for Estimators {
    /// The geometric rule alone.
    fn default() -> Self {
        Self::new(Arc::new(Geometric), Vec::new())
    }
}

impl Estimators {
    /// These estimators, of which the first is the default.
    pub fn new(default: Arc<dyn ContactEstimator>, others: Vec<Arc<dyn ContactEstimator>>) -> Self {
        Self(std::iter::once(default).chain(others).collect())
    }

    /// The estimator of that name, or the default.
    ///
    /// # Errors
    /// [`ServiceError::UnknownEstimator`].
    pub fn get(&self, name: Option<&str>) -> Result<Arc<dyn ContactEstimator>, ServiceError> {
        let found = match name {
            None => self.0.first(),
            Some(name) => self.0.iter().find(|e| e.name() == name),
        };
        found.map(Arc::clone).ok_or_else(|| ServiceError::UnknownEstimator {
            name: shortened(name.unwrap_or_default()),
            known: self.names().collect::<Vec<_>>().join(", "),
        })
    }

    /// Names, the default's first.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(|e| e.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_name_is_quoted_once_and_cut() {
        let error = |name: &str| Estimators::default().get(Some(name)).map(drop).unwrap_err().to_string();
        assert_eq!(error("unet"), "estimator \"unet\": not found; this server has geometric");
        assert!(error(&"x".repeat(100_000)).len() < 400);
    }
}
