//! The subcommands.

pub(crate) mod args;
pub(crate) mod bench;
#[cfg(feature = "sim")]
pub(crate) mod cell;
#[cfg(feature = "sim")]
pub(crate) mod dataset;
pub(crate) mod demo;
#[cfg(feature = "devices")]
pub(crate) mod device;
#[cfg(feature = "devices")]
pub(crate) mod emulate;
#[cfg(feature = "sim")]
pub(crate) mod eval;
pub(crate) mod hands;
pub(crate) mod plan;
pub(crate) mod serve;
