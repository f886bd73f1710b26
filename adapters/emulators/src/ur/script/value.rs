//! Values of a running script.

use super::super::geometry::Six;

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
            Self::Pose(pose) => Ok(*pose),
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
