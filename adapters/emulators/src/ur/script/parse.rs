//! Parser of the subset of URScript that control scripts use.

use std::sync::Arc;

use super::ast::{Block, Expr, Function, Kind, Operator, Scope, Statement};
use super::token::{Placed, ScriptError, Token, tokens};

/// Blocks and brackets nest at most so deep.
const DEEPEST: u32 = 60;

/// Reads a program: a `def` or `sec` is its program; statements on their own are a program without a name.
pub(crate) fn parse(text: &str) -> Result<Function, ScriptError> {
    let tokens = tokens(text)?;
    let mut parser = Parser { tokens, at: 0, depth: 0 };
    let mut statements = Block::new();
    while parser.peek().is_some() {
        statements.push(parser.statement()?);
    }
    let single = matches!(statements.as_slice(), [Statement { kind: Kind::Define(_), .. }]);
    match statements.pop() {
        Some(Statement { kind: Kind::Define(program), .. }) if single => Ok(Arc::unwrap_or_clone(program)),
        Some(last) => {
            statements.push(last);
            Ok(Function {
                name: "unnamed".into(),
                secondary: false,
                parameters: Vec::new(),
                body: statements,
            })
        }
        None => Err(ScriptError { line: 0, what: "an empty program".into() }),
    }
}

struct Parser {
    tokens: Vec<Placed>,
    at: usize,
    depth: u32,
}

type Words = &'static [(&'static str, Operator)];
type Arguments = Vec<(Option<String>, Expr)>;

impl Parser {
    fn peek(&self) -> Option<&Token> {
        self.tokens.get(self.at).map(|p| &p.token)
    }

    fn line(&self) -> u32 {
        self.tokens.get(self.at).or(self.tokens.last()).map_or(0, |p| p.line)
    }

    /// True when the next token stands in the line of the one before it.
    fn goes_on(&self) -> bool {
        let line = |at: usize| self.tokens.get(at).map(|p| p.line);
        self.at == 0 || line(self.at) == line(self.at - 1)
    }

    fn wrong<T>(&self, expected: &str) -> Result<T, ScriptError> {
        let found = self.peek().map_or("the end of the program".into(), |t| format!("{t:?}"));
        Err(ScriptError { line: self.line(), what: format!("found {found}, expected {expected}") })
    }

    fn is_sign(&self, sign: &str) -> bool {
        matches!(self.peek(), Some(Token::Sign(s)) if *s == sign)
    }

    fn is_name(&self, name: &str) -> bool {
        matches!(self.peek(), Some(Token::Name(n)) if n == name)
    }

    fn take_sign(&mut self, sign: &str) -> bool {
        let is = self.is_sign(sign);
        self.at += usize::from(is);
        is
    }

    fn take_name(&mut self, name: &str) -> bool {
        let is = self.is_name(name);
        self.at += usize::from(is);
        is
    }

    fn expect(&mut self, sign: &'static str) -> Result<(), ScriptError> {
        if self.take_sign(sign) { Ok(()) } else { self.wrong(sign) }
    }

    fn name(&mut self) -> Result<String, ScriptError> {
        match self.peek() {
            Some(Token::Name(name)) => {
                let name = name.clone();
                self.at += 1;
                Ok(name)
            }
            _ => self.wrong("a name"),
        }
    }

    fn deeper<T>(
        &mut self,
        inner: impl FnOnce(&mut Self) -> Result<T, ScriptError>,
    ) -> Result<T, ScriptError> {
        self.depth += 1;
        let result = if self.depth > DEEPEST { self.wrong("less nesting") } else { inner(self) };
        self.depth -= 1;
        result
    }

    /// Statements up to a word that ends them, which stays.
    fn block(&mut self) -> Result<Block, ScriptError> {
        self.take_sign(":");
        self.deeper(|parser| {
            let mut block = Block::new();
            while !["end", "else", "elif"].iter().any(|word| parser.is_name(word)) {
                if parser.peek().is_none() {
                    return parser.wrong("`end`");
                }
                block.push(parser.statement()?);
            }
            Ok(block)
        })
    }

    fn end(&mut self) -> Result<(), ScriptError> {
        if self.take_name("end") { Ok(()) } else { self.wrong("`end`") }
    }

    fn statement(&mut self) -> Result<Statement, ScriptError> {
        let line = self.line();
        let kind = match self.peek() {
            Some(Token::Name(word)) => match word.as_str() {
                "def" | "sec" | "thread" => self.function()?,
                "if" => self.conditional()?,
                "while" => {
                    self.at += 1;
                    let condition = self.expr()?;
                    let body = self.block()?;
                    self.end()?;
                    Kind::While { condition, body }
                }
                "return" => {
                    self.at += 1;
                    let bare = !self.goes_on() || self.peek().is_none() || self.is_name("end");
                    Kind::Return(if bare { None } else { Some(self.expr()?) })
                }
                "break" => self.word(Kind::Break),
                "continue" => self.word(Kind::Continue),
                "halt" => self.word(Kind::Halt),
                "enter_critical" | "exit_critical" | "pass" => self.word(Kind::Nothing),
                "kill" => {
                    self.at += 1;
                    Kind::Kill(self.expr()?)
                }
                "join" => {
                    self.at += 1;
                    Kind::Join(self.expr()?)
                }
                "global" => {
                    self.at += 1;
                    self.assignment(Scope::Global)?
                }
                "local" => {
                    self.at += 1;
                    self.assignment(Scope::Local)?
                }
                _ => self.assignment_or_call()?,
            },
            Some(Token::Sign(";")) => self.word(Kind::Nothing),
            _ => Kind::Expr(self.expr()?),
        };
        Ok(Statement { line, kind })
    }

    fn word(&mut self, kind: Kind) -> Kind {
        self.at += 1;
        // `halt()` is written, too.
        if self.is_sign("(") && self.tokens.get(self.at + 1).is_some_and(|p| p.token == Token::Sign(")")) {
            self.at += 2;
        }
        kind
    }

    fn assignment(&mut self, scope: Scope) -> Result<Kind, ScriptError> {
        let name = self.name()?;
        let value = if self.take_sign("=") { self.expr()? } else { Expr::Int(0) };
        Ok(Kind::Assign { scope, name, index: None, value })
    }

    fn assignment_or_call(&mut self) -> Result<Kind, ScriptError> {
        let target = self.expr()?;
        if !self.is_sign("=") {
            return Ok(Kind::Expr(target));
        }
        let (name, index) = match target {
            Expr::Name(name) => (name, None),
            Expr::Index(list, index) => match *list {
                Expr::Name(name) => (name, Some(*index)),
                _ => return self.wrong("a variable before `=`"),
            },
            _ => return self.wrong("a variable before `=`"),
        };
        self.expect("=")?;
        let value = self.expr()?;
        Ok(Kind::Assign { scope: Scope::Nearest, name, index, value })
    }

    fn function(&mut self) -> Result<Kind, ScriptError> {
        let secondary = self.is_name("sec");
        self.at += 1;
        let name = self.name()?;
        self.expect("(")?;
        let mut parameters = Vec::new();
        while !self.take_sign(")") {
            let parameter = self.name()?;
            let default = if self.take_sign("=") { Some(self.expr()?) } else { None };
            parameters.push((parameter, default));
            if !self.take_sign(",") && !self.is_sign(")") {
                return self.wrong("`,` or `)`");
            }
        }
        let body = self.block()?;
        self.end()?;
        Ok(Kind::Define(Arc::new(Function { name, secondary, parameters, body })))
    }

    fn conditional(&mut self) -> Result<Kind, ScriptError> {
        let mut arms = Vec::new();
        let mut otherwise = Block::new();
        self.at += 1;
        loop {
            let condition = self.expr()?;
            arms.push((condition, self.block()?));
            if self.take_name("elif") {
                continue;
            }
            if self.take_name("else") {
                if self.goes_on() && self.take_name("if") {
                    // `else if` nests, but is written flat by some.
                    continue;
                }
                otherwise = self.block()?;
            }
            self.end()?;
            return Ok(Kind::If { arms, otherwise });
        }
    }

    fn expr(&mut self) -> Result<Expr, ScriptError> {
        self.deeper(|parser| parser.binary(0))
    }

    fn operator(&self, level: usize) -> Option<Operator> {
        if !self.goes_on() {
            return None;
        }
        let (names, signs): (Words, Words) = match level {
            0 => (&[("or", Operator::Or), ("xor", Operator::Xor)], &[]),
            1 => (&[("and", Operator::And)], &[]),
            2 => (
                &[],
                &[
                    ("==", Operator::Equal),
                    ("!=", Operator::Different),
                    ("<", Operator::Less),
                    (">", Operator::More),
                    ("<=", Operator::AtMost),
                    (">=", Operator::AtLeast),
                ],
            ),
            3 => (&[], &[("+", Operator::Plus), ("-", Operator::Minus)]),
            _ => (&[], &[("*", Operator::Times), ("/", Operator::By), ("%", Operator::Modulo)]),
        };
        match self.peek() {
            Some(Token::Name(name)) => names.iter().find(|(n, _)| n == name).map(|(_, o)| *o),
            Some(Token::Sign(sign)) => signs.iter().find(|(s, _)| s == sign).map(|(_, o)| *o),
            _ => None,
        }
    }

    fn binary(&mut self, level: usize) -> Result<Expr, ScriptError> {
        if level == 5 {
            return self.unary();
        }
        if level == 2 && self.take_name("not") {
            // Of a whole comparison.
            return Ok(Expr::Not(Box::new(self.deeper(|parser| parser.binary(2))?)));
        }
        let mut left = self.binary(level + 1)?;
        // Chains of operators are left-deep trees: their length is bounded like nesting.
        let mut length = 0;
        while let Some(operator) = self.operator(level) {
            length += 1;
            if length > 4 * DEEPEST {
                return self.wrong("a shorter expression");
            }
            self.at += 1;
            let right = self.binary(level + 1)?;
            left = Expr::Binary(operator, Box::new(left), Box::new(right));
        }
        Ok(left)
    }

    fn unary(&mut self) -> Result<Expr, ScriptError> {
        if self.take_sign("-") {
            return Ok(Expr::Negative(Box::new(self.deeper(Self::unary)?)));
        }
        if self.take_sign("+") {
            return self.deeper(Self::unary);
        }
        let mut value = self.primary()?;
        let mut length = 0;
        while self.goes_on() && self.is_sign("[") {
            length += 1;
            if length > DEEPEST {
                return self.wrong("fewer indices");
            }
            self.at += 1;
            let index = self.expr()?;
            self.expect("]")?;
            value = Expr::Index(Box::new(value), Box::new(index));
        }
        Ok(value)
    }

    fn primary(&mut self) -> Result<Expr, ScriptError> {
        let Some(token) = self.peek().cloned() else { return self.wrong("a value") };
        match token {
            Token::Int(value) => self.literal(Expr::Int(value)),
            Token::Float(value) => self.literal(Expr::Float(value)),
            Token::Text(value) => self.literal(Expr::Text(value)),
            Token::Sign("(") => {
                self.at += 1;
                let value = self.expr()?;
                self.expect(")")?;
                Ok(value)
            }
            Token::Sign("[") => {
                self.at += 1;
                Ok(Expr::List(self.items()?))
            }
            Token::Name(name) => {
                self.at += 1;
                match name.as_str() {
                    "True" | "true" => Ok(Expr::Bool(true)),
                    "False" | "false" => Ok(Expr::Bool(false)),
                    "run" => {
                        let name = self.name()?;
                        self.expect("(")?;
                        let arguments = self.arguments()?;
                        Ok(Expr::Run { name, arguments })
                    }
                    "p" if self.goes_on() && self.is_sign("[") => {
                        self.at += 1;
                        let mut items = self.items()?;
                        match (items.len(), items.pop()) {
                            // A variable of that name.
                            (1, Some(index)) => Ok(Expr::Index(Box::new(Expr::Name(name)), Box::new(index))),
                            (6, Some(last)) => {
                                items.push(last);
                                Ok(Expr::Pose(items))
                            }
                            (count, _) => {
                                let what = format!("a pose of {count} numbers, expected 6");
                                Err(ScriptError { line: self.line(), what })
                            }
                        }
                    }
                    // A space is written before the bracket, too; a new line starts a new statement.
                    _ if self.goes_on() && self.take_sign("(") => {
                        let arguments = self.arguments()?;
                        Ok(Expr::Call { name, arguments })
                    }
                    "end" | "else" | "elif" | "def" | "thread" | "if" | "while" | "return" => {
                        self.at -= 1;
                        self.wrong("a value")
                    }
                    _ => Ok(Expr::Name(name)),
                }
            }
            Token::Sign(_) => self.wrong("a value"),
        }
    }

    fn literal(&mut self, value: Expr) -> Result<Expr, ScriptError> {
        self.at += 1;
        Ok(value)
    }

    fn items(&mut self) -> Result<Vec<Expr>, ScriptError> {
        let mut items = Vec::new();
        while !self.take_sign("]") {
            items.push(self.expr()?);
            if !self.take_sign(",") && !self.is_sign("]") {
                return self.wrong("`,` or `]`");
            }
        }
        Ok(items)
    }

    fn arguments(&mut self) -> Result<Arguments, ScriptError> {
        let mut arguments = Vec::new();
        while !self.take_sign(")") {
            let value = self.expr()?;
            let argument = match value {
                Expr::Name(name) if self.take_sign("=") => (Some(name), self.expr()?),
                value => (None, value),
            };
            arguments.push(argument);
            if !self.take_sign(",") && !self.is_sign(")") {
                return self.wrong("`,` or `)`");
            }
        }
        Ok(arguments)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_program_is_read() {
        let program = parse(
            "def f():\n global a = # of a\n1 global b = 2\n thread t():\n  while (True):\n   sync()\n  end\n end\n \
             p = p[0, 1, 2, 3, 4, 5]\n p[0] = p[1] * -2\n x = run t()\n if not a == 1 and b > 2:\n  kill x\n elif b:\n  \
             join x\n else:\n  return\n end\n movej(get_inverse_kin (p), a=1, v=0.5)\nend\n",
        )
        .unwrap();
        assert_eq!((program.name.as_str(), program.body.len()), ("f", 8));
        assert!(
            matches!(&program.body[0].kind, Kind::Assign { scope: Scope::Global, name, .. } if name == "a")
        );
        assert!(matches!(&program.body[4].kind, Kind::Assign { index: Some(_), .. }));
        let Kind::If { arms, otherwise } = &program.body[6].kind else { panic!("{program:?}") };
        assert_eq!((arms.len(), otherwise.len()), (2, 1));
    }

    #[test]
    fn errors_say_where_and_what() {
        for (text, expected) in [
            ("def f():\n x = \nend\n", "line 3: found Name(\"end\"), expected a value"),
            ("def f():\n", "expected `end`"),
            ("p[1, 2]", "a pose of 2 numbers"),
            ("f(1 2)", "expected `,` or `)`"),
            ("", "empty program"),
        ] {
            let error = parse(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
        assert!(parse(&"(".repeat(100_000)).is_err());
        assert!(parse(&"if 1:\n".repeat(10_000)).is_err());
        assert!(parse(&format!("x={}1", "-".repeat(100_000))).is_err());
        assert!(parse(&format!("x={}1", "1+".repeat(100_000))).is_err());
    }

    proptest! {
        #[test]
        fn any_text_is_survived(text in ".{0,300}") {
            let _ = parse(&text);
        }

        #[test]
        fn any_words_are_survived(words in prop::collection::vec(prop::sample::select(vec![
            "def", "f", "(", ")", ":", "end", "if", "else", "elif", "while", "p", "[", "]", ",", "1", "=", "==", "not",
            "run", "thread", "\n", "return", "global", "-", "+",
        ]), 0..60)) {
            let _ = parse(&words.join(" "));
        }
    }
}
