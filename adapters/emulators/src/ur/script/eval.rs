//! Statements and expressions of a running script.

use std::collections::HashMap;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use super::ast::{Block, Expr, Function, Kind, Operator, Scope};
use super::builtin::{Arguments, call_builtin};
use super::run::{BUDGET, Ended, Job, MOST_THREADS, Shared, Variables, locked, next_step};
use super::value::{LONGEST, Value, combine};

/// Calls nest at most so deep.
const DEEPEST: u32 = 40;

type Boxed<'a, T> = Pin<Box<dyn Future<Output = Result<T, Ended>> + Send + 'a>>;

/// How a block ended.
enum Flow {
    On,
    Break,
    Continue,
    Return(Value),
}

/// A function's run.
pub(super) struct Frame<'s> {
    shared: &'s Arc<Shared>,
    locals: HashMap<String, Value>,
    main: bool,
    depth: u32,
}

fn wrong<T>(line: u32, what: impl Into<String>) -> Result<T, Ended> {
    Err(Ended::Error { line, what: what.into() })
}

impl<'s> Frame<'s> {
    /// The frame of a program's own body.
    pub(super) fn of_program(shared: &'s Arc<Shared>) -> Self {
        Self { shared, locals: HashMap::new(), main: true, depth: 0 }
    }

    /// Runs a program's own body.
    pub(super) async fn whole(&mut self, body: &Block) -> Result<(), Ended> {
        self.block(body).await.map(|_| ())
    }

    fn spend(&self, line: u32) -> Result<(), Ended> {
        if self.shared.budget.fetch_add(1, Ordering::Relaxed) > BUDGET {
            return wrong(line, "infinite loop: nothing in it takes time");
        }
        Ok(())
    }

    fn block<'a>(&'a mut self, block: &'a Block) -> Boxed<'a, Flow> {
        Box::pin(async move {
            for statement in block {
                match self.statement(statement.line, &statement.kind).await? {
                    Flow::On => {}
                    other => return Ok(other),
                }
            }
            Ok(Flow::On)
        })
    }

    async fn statement(&mut self, line: u32, kind: &Kind) -> Result<Flow, Ended> {
        match kind {
            Kind::Assign { scope, name, index, value } => {
                let value = self.eval(line, value).await?;
                match index {
                    None => self.assign(*scope, name, value),
                    Some(index) => {
                        let index = self.eval(line, index).await?;
                        self.assign_item(line, name, &index, value)?;
                    }
                }
            }
            Kind::Define(function) => {
                let mut variables = locked(&self.shared.variables);
                variables.functions.insert(function.name.clone(), function.clone());
            }
            Kind::If { arms, otherwise } => {
                for (condition, body) in arms {
                    if self.condition(line, condition).await? {
                        return self.block(body).await;
                    }
                }
                return self.block(otherwise).await;
            }
            Kind::While { condition, body } => {
                while self.condition(line, condition).await? {
                    self.spend(line)?;
                    match self.block(body).await? {
                        Flow::On | Flow::Continue => {}
                        Flow::Break => break,
                        Flow::Return(value) => return Ok(Flow::Return(value)),
                    }
                }
            }
            Kind::Return(None) => return Ok(Flow::Return(Value::None)),
            Kind::Return(Some(value)) => return Ok(Flow::Return(self.eval(line, value).await?)),
            Kind::Break => return Ok(Flow::Break),
            Kind::Continue => return Ok(Flow::Continue),
            Kind::Halt => return Err(Ended::Halt),
            Kind::Kill(thread) => match self.eval(line, thread).await? {
                Value::Thread(id) => {
                    let mut threads = locked(&self.shared.threads);
                    threads.killed.insert(id);
                    threads.alive.remove(&id);
                }
                // What never ran has nothing to kill: scripts keep 0 where there is no thread.
                Value::Int(_) => {}
                other => return wrong(line, format!("kill: found {}, expected a thread", other.kind())),
            },
            Kind::Join(thread) => match self.eval(line, thread).await? {
                Value::Thread(id) => {
                    while locked(&self.shared.threads).alive.contains(&id) {
                        next_step().await;
                    }
                }
                other => return wrong(line, format!("join: found {}, expected a thread", other.kind())),
            },
            Kind::Expr(expr) => {
                self.eval(line, expr).await?;
            }
            Kind::Nothing => {}
        }
        Ok(Flow::On)
    }

    async fn condition(&mut self, line: u32, condition: &Expr) -> Result<bool, Ended> {
        let value = self.eval(line, condition).await?;
        value.truth().or_else(|what| wrong(line, format!("condition: {what}")))
    }

    fn assign(&mut self, scope: Scope, name: &str, value: Value) {
        let mut variables = locked(&self.shared.variables);
        let is_local = self.locals.contains_key(name);
        if scope == Scope::Global
            || (scope == Scope::Nearest && !is_local && variables.globals.contains_key(name))
        {
            variables.globals.insert(name.to_owned(), value);
        } else if self.main {
            variables.program.insert(name.to_owned(), value);
        } else {
            self.locals.insert(name.to_owned(), value);
        }
    }

    fn assign_item(&mut self, line: u32, name: &str, index: &Value, value: Value) -> Result<(), Ended> {
        let mut variables = locked(&self.shared.variables);
        let Variables { globals, program, .. } = &mut *variables;
        let locals = &mut self.locals;
        let held = locals.get_mut(name).or_else(|| globals.get_mut(name)).or_else(|| program.get_mut(name));
        let Some(list) = held else { return wrong(line, format!("{name} is not defined")) };
        let set = move || -> Result<(), String> {
            let index = usize::try_from(index.whole()?).map_err(|_| "a negative index".to_owned())?;
            match list {
                Value::Pose(pose) => {
                    *pose.get_mut(index).ok_or_else(|| format!("index {index} of a pose"))? =
                        value.number()?;
                }
                Value::List(items) => {
                    let length = items.len();
                    // A list in a list in a list would double without end.
                    if value.weight() > 100 {
                        return Err("a list that is too long for an item".into());
                    }
                    *items.get_mut(index).ok_or_else(|| format!("index {index} of {length} items"))? = value;
                }
                other => return Err(format!("found {}, expected a list", other.kind())),
            }
            Ok(())
        };
        set().or_else(|what| wrong(line, format!("{name}[..]: {what}")))
    }

    fn lookup(&self, line: u32, name: &str) -> Result<Value, Ended> {
        if let Some(value) = self.locals.get(name) {
            return Ok(value.clone());
        }
        let variables = locked(&self.shared.variables);
        match variables.globals.get(name).or_else(|| variables.program.get(name)) {
            Some(value) => Ok(value.clone()),
            None => wrong(line, format!("{name} is not defined")),
        }
    }

    fn eval<'a>(&'a mut self, line: u32, expr: &'a Expr) -> Boxed<'a, Value> {
        Box::pin(async move {
            Ok(match expr {
                Expr::Bool(value) => Value::Bool(*value),
                Expr::Int(value) => Value::Int(*value),
                Expr::Float(value) => Value::Float(*value),
                Expr::Text(value) => Value::Text(value.clone()),
                Expr::Name(name) => self.lookup(line, name)?,
                Expr::List(items) => {
                    let mut values = Vec::with_capacity(items.len());
                    for item in items {
                        values.push(self.eval(line, item).await?);
                    }
                    let list = Value::List(values);
                    if list.weight() > LONGEST {
                        return wrong(line, "a list that is too long");
                    }
                    list
                }
                Expr::Pose(items) => {
                    let mut pose = [0.0; 6];
                    for (to, item) in pose.iter_mut().zip(items) {
                        let value = self.eval(line, item).await?;
                        *to = value.number().or_else(|what| wrong(line, format!("pose: {what}")))?;
                    }
                    Value::Pose(pose)
                }
                Expr::Index(list, index) => {
                    let list = self.eval(line, list).await?;
                    let index = self.eval(line, index).await?;
                    let index = index.whole().or_else(|what| wrong(line, format!("index: {what}")))?;
                    let item = usize::try_from(index).ok().and_then(|i| match &list {
                        Value::List(items) => items.get(i).cloned(),
                        Value::Pose(pose) => pose.get(i).map(|v| Value::Float(*v)),
                        _ => None,
                    });
                    match item {
                        Some(item) => item,
                        None => return wrong(line, format!("no item {index} in {}", list.kind())),
                    }
                }
                Expr::Not(value) => {
                    let value = self.eval(line, value).await?;
                    Value::Bool(!value.truth().or_else(|what| wrong(line, format!("not: {what}")))?)
                }
                Expr::Negative(value) => match self.eval(line, value).await? {
                    Value::Int(value) => Value::Int(value.wrapping_neg()),
                    Value::Float(value) => Value::Float(-value),
                    other => return wrong(line, format!("-: found {}, expected a number", other.kind())),
                },
                Expr::Binary(operator, left, right) => {
                    let left = self.eval(line, left).await?;
                    // `and` and `or` look at the right side only where it matters.
                    match (operator, &left) {
                        (Operator::And, Value::Bool(false)) => return Ok(Value::Bool(false)),
                        (Operator::Or, Value::Bool(true)) => return Ok(Value::Bool(true)),
                        _ => {}
                    }
                    let right = self.eval(line, right).await?;
                    combine(*operator, &left, &right).or_else(|what| wrong(line, what))?
                }
                Expr::Run { name, arguments } => {
                    let arguments = self.arguments(line, arguments).await?;
                    self.run(line, name, arguments)?
                }
                Expr::Call { name, arguments } => {
                    let arguments = self.arguments(line, arguments).await?;
                    self.spend(line)?;
                    let function = locked(&self.shared.variables).functions.get(name).cloned();
                    match function {
                        Some(function) => {
                            let depth = self.depth + 1;
                            call(self.shared, line, &function, arguments, depth).await?
                        }
                        None => {
                            let done = call_builtin(self.shared, name, &arguments).await;
                            done.or_else(|what| wrong(line, format!("{name}: {what}")))?
                        }
                    }
                }
            })
        })
    }

    async fn arguments(
        &mut self,
        line: u32,
        arguments: &[(Option<String>, Expr)],
    ) -> Result<Arguments, Ended> {
        let mut out = Arguments::default();
        for (name, expr) in arguments {
            let value = self.eval(line, expr).await?;
            match name {
                Some(name) => out.named.push((name.clone(), value)),
                None => out.placed.push(value),
            }
        }
        Ok(out)
    }

    fn run(&mut self, line: u32, name: &str, arguments: Arguments) -> Result<Value, Ended> {
        let function = locked(&self.shared.variables).functions.get(name).cloned();
        let Some(function) = function else { return wrong(line, format!("{name} is not defined")) };
        let shared = self.shared.clone();
        let mut threads = locked(&self.shared.threads);
        if threads.alive.len() >= MOST_THREADS {
            return wrong(line, "too many threads");
        }
        let id = threads.next;
        threads.next += 1;
        threads.alive.insert(id);
        let job: Job =
            Box::pin(async move { call(&shared, line, &function, arguments, 1).await.map(|_| ()) });
        threads.started.push((id, job));
        Ok(Value::Thread(id))
    }
}

/// Calls a function of the script.
async fn call(
    shared: &Arc<Shared>,
    line: u32,
    function: &Function,
    arguments: Arguments,
    depth: u32,
) -> Result<Value, Ended> {
    if depth > DEEPEST {
        return wrong(line, "calls nest too deep");
    }
    let mut frame = Frame { shared, locals: HashMap::new(), main: false, depth };
    for (at, (name, default)) in function.parameters.iter().enumerate() {
        let value = match (arguments.get(at, name), default) {
            (Some(value), _) => value.clone(),
            (None, Some(default)) => frame.eval(line, default).await?,
            (None, None) => return wrong(line, format!("{}: {name} is missing", function.name)),
        };
        frame.locals.insert(name.clone(), value);
    }
    Ok(match frame.block(&function.body).await? {
        Flow::Return(value) => value,
        Flow::On | Flow::Break | Flow::Continue => Value::None,
    })
}
