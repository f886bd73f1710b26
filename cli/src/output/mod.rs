//! What is printed: tables for people, JSON for programs.

pub(crate) mod json;
pub(crate) mod table;
