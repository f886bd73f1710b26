//! The subcommands.

pub(crate) mod args;
pub(crate) mod bench;
pub(crate) mod demo;
#[cfg(feature = "sim")]
pub(crate) mod eval;
pub(crate) mod hands;
pub(crate) mod plan;
pub(crate) mod serve;
