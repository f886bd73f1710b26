//! URScript: the subset that control scripts use, run in step with the controller.

mod ast;
mod builtin;
mod eval;
mod parse;
mod run;
mod token;
mod value;

pub(crate) use parse::parse;
pub(crate) use run::{Program, Progress};
pub use token::ScriptError;
pub(crate) use token::Splitter;
