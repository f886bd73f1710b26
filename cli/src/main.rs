//! The `graspd` command: each subcommand a thin call into a crate.

fn main() {}
