//! Functions that the controller gives to scripts.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use super::run::{Shared, next_step};
use super::value::Value;
use crate::ur::geometry::{Six, from_six, to_six};
use crate::ur::motion::Order;
use crate::ur::robot::{Message, Robot, Watchdog};

/// Arguments of a call.
#[derive(Debug, Clone, Default)]
pub(crate) struct Arguments {
    pub(crate) placed: Vec<Value>,
    pub(crate) named: Vec<(String, Value)>,
}

impl Arguments {
    pub(crate) fn get(&self, at: usize, name: &str) -> Option<&Value> {
        self.named.iter().find(|(n, _)| n == name).map(|(_, v)| v).or_else(|| self.placed.get(at))
    }

    fn need(&self, at: usize, name: &str) -> Result<&Value, String> {
        self.get(at, name).ok_or_else(|| format!("argument {name} is missing"))
    }

    fn number(&self, at: usize, name: &str) -> Result<f64, String> {
        self.need(at, name)?.number().map_err(|what| format!("{name}: {what}"))
    }

    fn number_or(&self, at: usize, name: &str, default: f64) -> Result<f64, String> {
        self.get(at, name).map_or(Ok(default), |v| v.number().map_err(|what| format!("{name}: {what}")))
    }

    fn six(&self, at: usize, name: &str) -> Result<Six, String> {
        self.need(at, name)?.six().map_err(|what| format!("{name}: {what}"))
    }

    fn pose(&self, at: usize, name: &str) -> Result<Isometry3<f64>, String> {
        self.six(at, name).map(|six| from_six(&six))
    }

    fn positive(&self, at: usize, name: &str, default: f64) -> Result<f64, String> {
        let value = self.number_or(at, name, default)?;
        if value > 0.0 { Ok(value) } else { Err(format!("{name}: found {value}, expected more than 0")) }
    }

    fn register(&self, count: usize) -> Result<usize, String> {
        let number = self.need(0, "register")?.whole()?;
        usize::try_from(number)
            .ok()
            .filter(|n| *n < count)
            .ok_or_else(|| format!("register {number}, expected 0 to {}", count - 1))
    }
}

/// Brakes when a motion's call is dropped before its end: its thread was killed, or its program ended.
struct Moving<'s> {
    shared: &'s Shared,
    order: u64,
    armed: bool,
}

impl Drop for Moving<'_> {
    fn drop(&mut self) {
        if self.armed {
            let mut robot = self.shared.robot();
            if !robot.mover.is_done(self.order) {
                robot.mover.brake();
            }
        }
    }
}

fn give(shared: &Shared, order: Order) -> Result<u64, String> {
    if shared.secondary {
        return Err("a secondary program may not move the robot".into());
    }
    let mut robot = shared.robot();
    if !robot.can_move() {
        return Err("the robot cannot move now".into());
    }
    Ok(robot.mover.order(order))
}

/// Gives an order and waits for its end.
async fn moved(shared: &Shared, order: Order) -> Result<Value, String> {
    let order = give(shared, order)?;
    let mut moving = Moving { shared, order, armed: true };
    loop {
        next_step().await;
        if shared.robot().mover.is_done(order) {
            moving.armed = false;
            return Ok(Value::None);
        }
    }
}

/// Gives an order and waits for so long, while the robot goes on with it.
async fn moved_for(shared: &Shared, order: Order, time_s: f64) -> Result<Value, String> {
    give(shared, order)?;
    let step_s = shared.robot().step_s;
    let until = shared.robot().time_s + time_s - 0.5 * step_s;
    loop {
        next_step().await;
        if shared.robot().time_s >= until {
            return Ok(Value::None);
        }
    }
}

fn to_joints(robot: &Robot, target: &Value, what: &str) -> Result<Six, String> {
    match target {
        Value::Pose(pose) => {
            let flange = from_six(pose) * robot.mover.tcp().inverse();
            let found = robot.model.joints(&flange, &robot.mover.q);
            found.ok_or_else(|| format!("{what}: no inverse kinematics for {}", target.shown()))
        }
        other => other.six().map_err(|e| format!("{what}: {e}")),
    }
}

fn within_turns(q: &Six) -> Result<(), String> {
    let most = 2.0 * std::f64::consts::PI + 1e-6;
    match q.iter().position(|v| v.abs() > most) {
        Some(joint) => Err(format!("joint {joint}: found {}, expected within +-2 pi", q[joint])),
        None => Ok(()),
    }
}

fn inverse(shared: &Shared, arguments: &Arguments) -> Result<Option<Six>, String> {
    let robot = shared.robot();
    let near = match arguments.get(1, "qnear") {
        Some(near) => near.six()?,
        None => robot.mover.q,
    };
    let tcp = match arguments.get(4, "tcp") {
        Some(tcp) => from_six(&tcp.six()?),
        None => robot.mover.tcp(),
    };
    Ok(robot.model.joints(&(arguments.pose(0, "x")? * tcp.inverse()), &near))
}

pub(crate) async fn call_builtin(shared: &Shared, name: &str, a: &Arguments) -> Result<Value, String> {
    match name {
        "movej" => {
            let to = {
                let robot = shared.robot();
                to_joints(&robot, a.need(0, "q")?, "movej")?
            };
            within_turns(&to)?;
            let (acceleration, speed) = (a.positive(1, "a", 1.4)?, a.positive(2, "v", 1.05)?);
            let time_s = a.number_or(3, "t", 0.0)?;
            moved(shared, Order::Joint { to, speed, acceleration, time_s }).await
        }
        "movel" | "movep" => {
            let to = match a.need(0, "pose")? {
                Value::Pose(pose) => from_six(pose),
                joints => {
                    let robot = shared.robot();
                    robot.model.flange(&joints.six()?) * robot.mover.tcp()
                }
            };
            let (acceleration, speed) = (a.positive(1, "a", 1.2)?, a.positive(2, "v", 0.25)?);
            let time_s = if name == "movel" { a.number_or(3, "t", 0.0)? } else { 0.0 };
            moved(shared, Order::Linear { to, speed, acceleration, time_s }).await
        }
        "servoj" => {
            let to = a.six(0, "q")?;
            within_turns(&to)?;
            let step_s = shared.robot().step_s;
            let time_s = a.number_or(3, "t", step_s)?.max(step_s);
            let (lookahead_s, gain) =
                (a.number_or(4, "lookahead_time", 0.1)?, a.number_or(5, "gain", 300.0)?);
            if !(0.03..=0.2).contains(&lookahead_s) || !(100.0..=2000.0).contains(&gain) {
                return Err(format!("lookahead_time {lookahead_s} or gain {gain} out of range"));
            }
            moved_for(shared, Order::Servo { to, time_s, lookahead_s, gain }, time_s).await
        }
        "speedj" | "speedl" => {
            let speeds = a.six(0, "qd")?;
            let acceleration = a.positive(1, "a", 1.4)?;
            let time_s = a.number_or(2, "t", 0.0)?;
            let order = if name == "speedj" {
                Order::SpeedJoint { qd: speeds, acceleration, time_s }
            } else {
                Order::SpeedLinear { xd: speeds, acceleration, time_s }
            };
            if time_s > 0.0 {
                return moved_for(shared, order, time_s).await;
            }
            moved(shared, order).await
        }
        "stopj" => moved(shared, Order::StopJoint { deceleration: a.positive(0, "a", 2.0)? }).await,
        "stopl" => moved(shared, Order::StopLinear { deceleration: a.positive(0, "a", 2.0)? }).await,
        "sync" => {
            next_step().await;
            Ok(Value::None)
        }
        "sleep" => {
            let until = shared.robot().time_s + a.number(0, "t")?;
            while shared.robot().time_s < until {
                next_step().await;
            }
            Ok(Value::None)
        }
        _ => instant(shared, name, a),
    }
}

/// Functions that take no time.
fn instant(shared: &Shared, name: &str, a: &Arguments) -> Result<Value, String> {
    if let Some(value) = mathematics(name, a)? {
        return Ok(value);
    }
    if let Some(value) = registers(shared, name, a)? {
        return Ok(value);
    }
    if let Some(value) = reports(shared, name, a)? {
        return Ok(value);
    }
    let mut robot = shared.robot();
    match name {
        "textmsg" => {
            let text: String = a.placed.iter().map(Value::shown).collect();
            robot.tell(Message::Text(text));
        }
        "popup" => robot.tell(Message::Key { title: "popup".into(), text: a.need(0, "s")?.shown() }),
        "set_tcp" => {
            let tcp = a.six(0, "pose")?;
            robot.set_tcp(&tcp);
        }
        "set_payload" | "set_target_payload" => {
            robot.payload_kg = a.number(0, "m")?;
            if let Some(Value::List(cog)) = a.get(1, "cog") {
                for (to, from) in robot.payload_cog.iter_mut().zip(cog) {
                    *to = from.number()?;
                }
            }
        }
        "set_payload_mass" => robot.payload_kg = a.number(0, "m")?,
        "zero_ftsensor" => robot.force_zero = robot.state.wrench,
        "set_digital_out" | "set_standard_digital_out" => set_output(&mut robot, a, 0, 8)?,
        "set_configurable_digital_out" => set_output(&mut robot, a, 8, 8)?,
        "set_tool_digital_out" => set_output(&mut robot, a, 16, 2)?,
        "set_tool_voltage" => robot.tool_voltage = a.need(0, "voltage")?.whole()?,
        "rtde_set_watchdog" => {
            let field = a.need(0, "variable_name")?.shown();
            let hz = a.positive(1, "min_frequency", 1.0)?;
            let fed_s = robot.time_s;
            robot.watchdog = Some(Watchdog { field, period_s: 1.0 / hz, fed_s });
        }
        // Settings of a force controller that is not emulated: accepted, without effect.
        "force_mode_set_damping"
        | "force_mode_set_gain_scaling"
        | "end_force_mode"
        | "set_gravity"
        | "end_freedrive_mode" => {}
        _ => return Err("not a function of this controller (or not emulated)".into()),
    }
    Ok(Value::None)
}

fn set_output(robot: &mut Robot, a: &Arguments, first: u32, count: i32) -> Result<(), String> {
    let n = a.need(0, "n")?.whole()?;
    if !(0..count).contains(&n) {
        return Err(format!("output {n}, expected 0 to {}", count - 1));
    }
    let bit = 1 << (first + n as u32);
    if a.need(1, "b")?.truth()? {
        robot.digital_out |= bit
    } else {
        robot.digital_out &= !bit
    }
    Ok(())
}

fn mathematics(name: &str, a: &Arguments) -> Result<Option<Value>, String> {
    let x = || a.number(0, "x");
    Ok(Some(match name {
        "abs" => match a.need(0, "x")? {
            Value::Int(value) => Value::Int(value.wrapping_abs()),
            other => Value::Float(other.number()?.abs()),
        },
        "sqrt" => Value::Float(x()?.max(0.0).sqrt()),
        "sin" => Value::Float(x()?.sin()),
        "cos" => Value::Float(x()?.cos()),
        "acos" => Value::Float(x()?.clamp(-1.0, 1.0).acos()),
        "asin" => Value::Float(x()?.clamp(-1.0, 1.0).asin()),
        "atan2" => Value::Float(x()?.atan2(a.number(1, "y")?)),
        "floor" => Value::Int(x()?.floor() as i32),
        "ceil" => Value::Int(x()?.ceil() as i32),
        "d2r" => Value::Float(x()?.to_radians()),
        "r2d" => Value::Float(x()?.to_degrees()),
        "norm" => Value::Float(match a.need(0, "a")? {
            Value::List(items) => {
                let mut sum = 0.0;
                for item in items {
                    sum += item.number()?.powi(2);
                }
                sum.sqrt()
            }
            Value::Pose(pose) => pose.iter().map(|v| v * v).sum::<f64>().sqrt(),
            other => other.number()?.abs(),
        }),
        "length" => match a.need(0, "v")? {
            Value::List(items) => Value::Int(items.len() as i32),
            Value::Text(text) => Value::Int(text.len() as i32),
            other => return Err(format!("found {}, expected a list", other.kind())),
        },
        "to_str" | "str_cat" => Value::Text(a.placed.iter().map(Value::shown).collect()),
        "pose_trans" => Value::Pose(to_six(&(a.pose(0, "p_from")? * a.pose(1, "p_from_to")?))),
        "pose_inv" => Value::Pose(to_six(&a.pose(0, "p_from")?.inverse())),
        "pose_add" | "pose_sub" => {
            let (first, second) = (a.pose(0, "p_1")?, a.pose(1, "p_2")?);
            let sign = if name == "pose_add" { 1.0 } else { -1.0 };
            let way = first.translation.vector + second.translation.vector * sign;
            let turn = if sign > 0.0 { second.rotation } else { second.rotation.inverse() };
            let rotation: UnitQuaternion<f64> = first.rotation * turn;
            Value::Pose(to_six(&Isometry3::from_parts(Translation3::from(way), rotation)))
        }
        _ => return Ok(None),
    }))
}

fn registers(shared: &Shared, name: &str, a: &Arguments) -> Result<Option<Value>, String> {
    let mut robot = shared.robot();
    Ok(Some(match name {
        "read_input_integer_register" => Value::Int(robot.inputs.ints[a.register(48)?]),
        "read_input_float_register" => Value::Float(robot.inputs.doubles[a.register(48)?]),
        "read_input_boolean_register" => Value::Bool(robot.inputs.bits[a.register(128)?]),
        "read_output_integer_register" => Value::Int(robot.outputs.ints[a.register(48)?]),
        "read_output_float_register" => Value::Float(robot.outputs.doubles[a.register(48)?]),
        "read_output_boolean_register" => Value::Bool(robot.outputs.bits[a.register(128)?]),
        "write_output_integer_register" => {
            robot.outputs.ints[a.register(48)?] = a.need(1, "value")?.whole()?;
            Value::None
        }
        "write_output_float_register" => {
            robot.outputs.doubles[a.register(48)?] = a.number(1, "value")?;
            Value::None
        }
        "write_output_boolean_register" => {
            robot.outputs.bits[a.register(128)?] = a.need(1, "value")?.truth()?;
            Value::None
        }
        _ => return Ok(None),
    }))
}

/// What the robot says of itself.
fn reports(shared: &Shared, name: &str, a: &Arguments) -> Result<Option<Value>, String> {
    if name == "get_inverse_kin" {
        let found = inverse(shared, a)?;
        return found.map(|q| Some(Value::list(&q))).ok_or_else(|| "no solution".into());
    }
    if name == "get_inverse_kin_has_solution" {
        return inverse(shared, a).map(|found| Some(Value::Bool(found.is_some())));
    }
    let robot = shared.robot();
    let tcp_twist = |qd: &Six| Value::list(&robot.mover.tcp_twist(qd));
    Ok(Some(match name {
        "get_steptime" => Value::Float(robot.step_s),
        "get_actual_joint_positions" => Value::list(&robot.state.q),
        "get_target_joint_positions" => Value::list(&robot.mover.q),
        "get_actual_joint_speeds" => Value::list(&robot.state.qd),
        "get_target_joint_speeds" => Value::list(&robot.mover.qd),
        "get_actual_joint_positions_history" => {
            let steps = usize::try_from(a.need(0, "steps")?.whole()?).map_err(|e| e.to_string())?;
            Value::list(robot.history.get(steps).unwrap_or(&robot.state.q))
        }
        "get_actual_tcp_pose" => Value::Pose(to_six(&robot.actual_tcp())),
        "get_target_tcp_pose" => Value::Pose(to_six(&robot.mover.base_from_tcp())),
        "get_actual_tool_flange_pose" => Value::Pose(to_six(&robot.actual_flange())),
        "get_actual_tcp_speed" => tcp_twist(&robot.state.qd),
        "get_target_tcp_speed" => tcp_twist(&robot.mover.qd),
        "get_tcp_offset" => Value::Pose(to_six(&robot.mover.tcp())),
        "get_tcp_force" => Value::list(&robot.wrench()),
        "force" => {
            let wrench = robot.wrench();
            Value::Float(Vector3::new(wrench[0], wrench[1], wrench[2]).norm())
        }
        "get_joint_torques" => Value::list(&[0.0; 6]),
        "get_forward_kin" => {
            let q = a.get(0, "q").map_or(Ok(robot.state.q), Value::six)?;
            let tcp = match a.get(1, "tcp") {
                Some(tcp) => from_six(&tcp.six()?),
                None => robot.mover.tcp(),
            };
            Value::Pose(to_six(&(robot.model.flange(&q) * tcp)))
        }
        "get_target_payload" => Value::Float(robot.payload_kg),
        "get_target_payload_cog" => Value::list(&robot.payload_cog),
        "get_target_payload_inertia" => Value::list(&[0.0; 6]),
        "is_steady" => Value::Bool(robot.is_steady()),
        "is_within_safety_limits" => {
            let reachable = match a.need(0, "pose")? {
                Value::Pose(pose) => {
                    let flange = from_six(pose) * robot.mover.tcp().inverse();
                    robot.model.joints(&flange, &robot.mover.q).is_some()
                }
                joints => within_turns(&joints.six()?).is_ok(),
            };
            Value::Bool(reachable)
        }
        "tool_contact" => {
            let wrench = robot.wrench();
            let force = Vector3::new(wrench[0], wrench[1], wrench[2]);
            let along = a.get(0, "direction").map_or(Ok([0.0; 6]), Value::six)?;
            let along = Vector3::new(along[0], along[1], along[2]);
            // Something pushes against the way the tool goes; seen ten steps after it began.
            let against = if along.norm() > 1e-9 { -force.dot(&along.normalize()) } else { force.norm() };
            Value::Int(if against > 10.0 { 10 } else { 0 })
        }
        "get_standard_digital_in" | "get_digital_in" => {
            let n = a.need(0, "n")?.whole()?;
            Value::Bool((0..18).contains(&n) && (robot.digital_in >> n) & 1 == 1)
        }
        "get_freedrive_status" => Value::Int(0),
        _ => return Ok(None),
    }))
}
