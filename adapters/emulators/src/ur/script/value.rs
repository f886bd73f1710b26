//! Values of a running script.

use super::super::geometry::Six;
use super::ast::Operator;

/// Longest text and list that a script may make.
pub(super) const LONGEST: usize = 4096;

/// A value. Lists are copied, as URScript does.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Value {
    None,
    Bool(bool),
    Int(i32),
    Float(f64),
    Text(String),
    List(Vec<Value>),
    Pose(Six),
    Thread(u32),
}

impl Value {
    pub(crate) fn kind(&self) -> &'static str {
        match self {
            Self::None => "nothing",
            Self::Bool(_) => "a boolean",
            Self::Int(_) => "an integer",
            Self::Float(_) => "a float",
            Self::Text(_) => "a text",
            Self::List(_) => "a list",
            Self::Pose(_) => "a pose",
            Self::Thread(_) => "a thread",
        }
    }

    pub(crate) fn truth(&self) -> Result<bool, String> {
        match self {
            Self::Bool(value) => Ok(*value),
            other => Err(format!("found {}, expected a boolean", other.kind())),
        }
    }

    pub(crate) fn number(&self) -> Result<f64, String> {
        match self {
            Self::Int(value) => Ok(f64::from(*value)),
            Self::Float(value) if value.is_finite() => Ok(*value),
            other => Err(format!("found {}, expected a number", other.kind())),
        }
    }

    pub(crate) fn whole(&self) -> Result<i32, String> {
        match self {
            Self::Int(value) => Ok(*value),
            Self::Bool(value) => Ok(i32::from(*value)),
            Self::Float(value) if value.fract() == 0.0 && value.abs() < 2e9 => Ok(*value as i32),
            other => Err(format!("found {}, expected an integer", other.kind())),
        }
    }

    /// Six numbers of a list or pose.
    pub(crate) fn six(&self) -> Result<Six, String> {
        match self {
            Self::Pose(pose) if pose.iter().all(|v| v.is_finite()) => Ok(*pose),
            Self::Pose(_) => Err("found a pose that is not finite".into()),
            Self::List(items) if items.len() == 6 => {
                let mut six = [0.0; 6];
                for (to, item) in six.iter_mut().zip(items) {
                    *to = item.number()?;
                }
                Ok(six)
            }
            other => Err(format!("found {}, expected six numbers", other.kind())),
        }
    }

    /// Numbers and characters in it: what it costs to copy.
    pub(crate) fn weight(&self) -> usize {
        match self {
            Self::List(items) => 1 + items.iter().map(Self::weight).sum::<usize>(),
            Self::Text(text) => 1 + text.len() / 16,
            _ => 1,
        }
    }

    pub(crate) fn list(numbers: &[f64]) -> Self {
        Self::List(numbers.iter().map(|v| Self::Float(*v)).collect())
    }

    pub(crate) fn shown(&self) -> String {
        match self {
            Self::None => "None".into(),
            Self::Bool(true) => "True".into(),
            Self::Bool(false) => "False".into(),
            Self::Int(value) => value.to_string(),
            Self::Float(value) => value.to_string(),
            Self::Text(value) => value.clone(),
            Self::List(items) => {
                format!("[{}]", items.iter().map(Self::shown).collect::<Vec<_>>().join(", "))
            }
            Self::Pose(pose) => format!("p{pose:?}"),
            Self::Thread(id) => format!("thread {id}"),
        }
    }
}

/// What an operator makes of two values.
pub(crate) fn combine(operator: Operator, left: &Value, right: &Value) -> Result<Value, String> {
    use Operator as O;
    Ok(match operator {
        O::And => Value::Bool(left.truth()? && right.truth()?),
        O::Or => Value::Bool(left.truth()? || right.truth()?),
        O::Xor => Value::Bool(left.truth()? != right.truth()?),
        O::Equal | O::Different => {
            let same = match (left, right) {
                (Value::Int(_) | Value::Float(_), Value::Int(_) | Value::Float(_)) => {
                    left.number()? == right.number()?
                }
                _ => left == right,
            };
            Value::Bool(same == (operator == O::Equal))
        }
        O::Less => Value::Bool(left.number()? < right.number()?),
        O::More => Value::Bool(left.number()? > right.number()?),
        O::AtMost => Value::Bool(left.number()? <= right.number()?),
        O::AtLeast => Value::Bool(left.number()? >= right.number()?),
        O::Plus | O::Minus | O::Times | O::By | O::Modulo => arithmetic(operator, left, right)?,
    })
}

fn arithmetic(operator: Operator, left: &Value, right: &Value) -> Result<Value, String> {
    use Operator as O;
    if let (Value::Text(a), O::Plus) = (left, operator) {
        let text = format!("{a}{}", right.shown());
        return if text.len() > LONGEST {
            Err("a text that is too long".into())
        } else {
            Ok(Value::Text(text))
        };
    }
    if let (Value::Int(a), Value::Int(b)) = (left, right) {
        let whole = match operator {
            O::Plus => Some(a.wrapping_add(*b)),
            O::Minus => Some(a.wrapping_sub(*b)),
            O::Times => Some(a.wrapping_mul(*b)),
            O::Modulo => Some(a.checked_rem(*b).ok_or("division by zero")?),
            _ => None,
        };
        if let Some(whole) = whole {
            return Ok(Value::Int(whole));
        }
    }
    let (a, b) = (left.number()?, right.number()?);
    if matches!(operator, O::By | O::Modulo) && b == 0.0 {
        return Err("division by zero".into());
    }
    Ok(Value::Float(match operator {
        O::Plus => a + b,
        O::Minus => a - b,
        O::Times => a * b,
        O::By => a / b,
        _ => a % b,
    }))
}
