//! What a script says.

use std::sync::Arc;

/// A statement and its line.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Statement {
    pub(crate) line: u32,
    pub(crate) kind: Kind,
}

/// A block of statements.
pub(crate) type Block = Vec<Statement>;

#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Kind {
    Assign { scope: Scope, name: String, index: Option<Expr>, value: Expr },
    Define(Arc<Function>),
    If { arms: Vec<(Expr, Block)>, otherwise: Block },
    While { condition: Expr, body: Block },
    Return(Option<Expr>),
    Break,
    Continue,
    Halt,
    Kill(Expr),
    Join(Expr),
    Expr(Expr),
    Nothing,
}

/// Where an assignment puts its value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Scope {
    Nearest,
    Global,
    Local,
}

/// A function, a thread, or a program.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Function {
    pub(crate) name: String,
    pub(crate) secondary: bool,
    pub(crate) parameters: Vec<(String, Option<Expr>)>,
    pub(crate) body: Block,
}

#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Expr {
    Bool(bool),
    Int(i32),
    Float(f64),
    Text(String),
    Name(String),
    List(Vec<Expr>),
    Pose(Vec<Expr>),
    Index(Box<Expr>, Box<Expr>),
    Call { name: String, arguments: Vec<(Option<String>, Expr)> },
    Run { name: String, arguments: Vec<(Option<String>, Expr)> },
    Not(Box<Expr>),
    Negative(Box<Expr>),
    Binary(Operator, Box<Expr>, Box<Expr>),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Operator {
    Or,
    And,
    Xor,
    Equal,
    Different,
    Less,
    More,
    AtMost,
    AtLeast,
    Plus,
    Minus,
    Times,
    By,
    Modulo,
}
