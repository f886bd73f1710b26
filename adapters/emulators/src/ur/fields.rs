//! Fields of RTDE: names, types on the wire, and where their values are.

use super::geometry::{Six, to_six};
use super::robot::Robot;

/// Types on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Bool,
    Uint8,
    Uint32,
    Int32,
    Uint64,
    Double,
    Vector3,
    Vector6,
    Vector6Int32,
}

impl Kind {
    pub(crate) fn word(self) -> &'static str {
        match self {
            Self::Bool => "BOOL",
            Self::Uint8 => "UINT8",
            Self::Uint32 => "UINT32",
            Self::Int32 => "INT32",
            Self::Uint64 => "UINT64",
            Self::Double => "DOUBLE",
            Self::Vector3 => "VECTOR3D",
            Self::Vector6 => "VECTOR6D",
            Self::Vector6Int32 => "VECTOR6INT32",
        }
    }

    pub(crate) fn size(self) -> usize {
        match self {
            Self::Bool | Self::Uint8 => 1,
            Self::Uint32 | Self::Int32 => 4,
            Self::Uint64 | Self::Double => 8,
            Self::Vector3 | Self::Vector6Int32 => 24,
            Self::Vector6 => 48,
        }
    }
}

type Get = fn(&Robot, usize) -> Out;

/// A value that goes out.
pub(crate) enum Out {
    Bool(bool),
    Uint32(u32),
    Int32(i32),
    Uint64(u64),
    Double(f64),
    Vector3([f64; 3]),
    Vector6(Six),
    Vector6Int32([i32; 6]),
}

impl Out {
    fn write(&self, to: &mut Vec<u8>) {
        match self {
            Self::Bool(v) => to.push(u8::from(*v)),
            Self::Uint32(v) => to.extend(v.to_be_bytes()),
            Self::Int32(v) => to.extend(v.to_be_bytes()),
            Self::Uint64(v) => to.extend(v.to_be_bytes()),
            Self::Double(v) => to.extend(v.to_be_bytes()),
            Self::Vector3(v) => v.iter().for_each(|v| to.extend(v.to_be_bytes())),
            Self::Vector6(v) => v.iter().for_each(|v| to.extend(v.to_be_bytes())),
            Self::Vector6Int32(v) => v.iter().for_each(|v| to.extend(v.to_be_bytes())),
        }
    }
}

/// A field that a client can read.
#[derive(Clone, Copy)]
pub(crate) struct Output {
    pub(crate) kind: Kind,
    index: usize,
    get: Get,
}

impl Output {
    pub(crate) fn write(&self, robot: &Robot, to: &mut Vec<u8>) {
        (self.get)(robot, self.index).write(to);
    }
}

/// A number at the end of a name.
fn indexed(name: &str, stem: &str, from: usize, to: usize) -> Option<usize> {
    let digits = name.strip_prefix(stem)?;
    let plain = digits.bytes().all(|b| b.is_ascii_digit()) && (digits == "0" || !digits.starts_with('0'));
    digits.parse().ok().filter(|n| plain && (from..=to).contains(n))
}

fn word_of(bits: &[bool]) -> u32 {
    bits.iter().enumerate().fold(0, |word, (i, bit)| word | (u32::from(*bit) << i))
}

/// The field of a name.
pub(crate) fn output(name: &str) -> Option<Output> {
    let registers: [(&str, usize, usize, Kind, Get); 6] = [
        ("output_int_register_", 0, 47, Kind::Int32, |r, i| Out::Int32(r.outputs.ints[i])),
        ("output_double_register_", 0, 47, Kind::Double, |r, i| Out::Double(r.outputs.doubles[i])),
        ("output_bit_register_", 64, 127, Kind::Bool, |r, i| Out::Bool(r.outputs.bits[i])),
        ("input_int_register_", 0, 47, Kind::Int32, |r, i| Out::Int32(r.inputs.ints[i])),
        ("input_double_register_", 0, 47, Kind::Double, |r, i| Out::Double(r.inputs.doubles[i])),
        ("input_bit_register_", 64, 127, Kind::Bool, |r, i| Out::Bool(r.inputs.bits[i])),
    ];
    for (stem, from, to, kind, get) in registers {
        if let Some(index) = indexed(name, stem, from, to) {
            return Some(Output { kind, index, get });
        }
    }
    let (kind, get): (Kind, Get) = match name {
        "timestamp" => (Kind::Double, |r, _| Out::Double(r.time_s)),
        "target_q" => (Kind::Vector6, |r, _| Out::Vector6(r.mover.q)),
        "target_qd" => (Kind::Vector6, |r, _| Out::Vector6(r.mover.qd)),
        "actual_q" => (Kind::Vector6, |r, _| Out::Vector6(r.state.q)),
        "actual_qd" => (Kind::Vector6, |r, _| Out::Vector6(r.state.qd)),
        "target_qdd"
        | "target_current"
        | "target_moment"
        | "actual_current"
        | "joint_control_output"
        | "actual_current_window"
        | "payload_inertia" => (Kind::Vector6, |_, _| Out::Vector6([0.0; 6])),
        "actual_TCP_pose" => (Kind::Vector6, |r, _| Out::Vector6(to_six(&r.actual_tcp()))),
        "target_TCP_pose" => (Kind::Vector6, |r, _| Out::Vector6(to_six(&r.mover.base_from_tcp()))),
        "actual_TCP_speed" => (Kind::Vector6, |r, _| Out::Vector6(r.mover.tcp_twist(&r.state.qd))),
        "target_TCP_speed" => (Kind::Vector6, |r, _| Out::Vector6(r.mover.tcp_twist(&r.mover.qd))),
        "actual_TCP_force" => (Kind::Vector6, |r, _| Out::Vector6(r.wrench())),
        "ft_raw_wrench" => (Kind::Vector6, |r, _| Out::Vector6(r.state.wrench)),
        "tcp_offset" => (Kind::Vector6, |r, _| Out::Vector6(to_six(&r.mover.tcp()))),
        "joint_temperatures" => (Kind::Vector6, |_, _| Out::Vector6([30.0; 6])),
        "actual_joint_voltage" => (Kind::Vector6, |_, _| Out::Vector6([48.0; 6])),
        "joint_mode" => (Kind::Vector6Int32, |r, _| Out::Vector6Int32([joint_mode(r.mode); 6])),
        "robot_mode" => (Kind::Int32, |r, _| Out::Int32(r.mode)),
        "safety_mode" | "safety_status" => (Kind::Int32, |r, _| Out::Int32(r.safety().number())),
        "runtime_state" => (Kind::Uint32, |r, _| Out::Uint32(r.runtime)),
        "robot_status_bits" => (Kind::Uint32, |r, _| Out::Uint32(status_bits(r))),
        "safety_status_bits" => (Kind::Uint32, |r, _| Out::Uint32(r.safety().bits())),
        "speed_scaling" | "target_speed_fraction" => (Kind::Double, |r, _| Out::Double(r.slider)),
        "actual_execution_time"
        | "actual_momentum"
        | "tool_output_current"
        | "tool_temperature"
        | "tool_analog_input0"
        | "tool_analog_input1"
        | "standard_analog_input0"
        | "standard_analog_input1"
        | "io_current"
        | "tcp_force_scalar"
        | "actual_robot_current" => (Kind::Double, |_, _| Out::Double(0.0)),
        "actual_main_voltage" | "actual_robot_voltage" => (Kind::Double, |_, _| Out::Double(48.0)),
        "standard_analog_output0" => (Kind::Double, |r, _| Out::Double(r.analog_out[0])),
        "standard_analog_output1" => (Kind::Double, |r, _| Out::Double(r.analog_out[1])),
        "payload" => (Kind::Double, |r, _| Out::Double(r.payload_kg)),
        "payload_cog" => (Kind::Vector3, |r, _| Out::Vector3(r.payload_cog)),
        "actual_tool_accelerometer" => (Kind::Vector3, |_, _| Out::Vector3([0.0, 0.0, 9.81])),
        "elbow_position" | "elbow_velocity" => (Kind::Vector3, |_, _| Out::Vector3([0.0; 3])),
        "actual_digital_input_bits" => (Kind::Uint64, |r, _| Out::Uint64(r.digital_in)),
        "actual_digital_output_bits" => (Kind::Uint64, |r, _| Out::Uint64(r.digital_out)),
        "tool_output_voltage" => (Kind::Int32, |r, _| Out::Int32(r.tool_voltage)),
        "analog_io_types" | "tool_mode" | "tool_output_mode" | "script_control_line" => {
            (Kind::Uint32, |_, _| Out::Uint32(0))
        }
        "output_bit_registers0_to_31" => (Kind::Uint32, |r, _| Out::Uint32(word_of(&r.outputs.bits[..32]))),
        "output_bit_registers32_to_63" => {
            (Kind::Uint32, |r, _| Out::Uint32(word_of(&r.outputs.bits[32..64])))
        }
        "input_bit_registers0_to_31" => (Kind::Uint32, |r, _| Out::Uint32(word_of(&r.inputs.bits[..32]))),
        "input_bit_registers32_to_63" => (Kind::Uint32, |r, _| Out::Uint32(word_of(&r.inputs.bits[32..64]))),
        _ => return None,
    };
    Some(Output { kind, index: 0, get })
}

fn joint_mode(robot_mode: i32) -> i32 {
    match robot_mode {
        super::robot::mode::RUNNING => 253,
        super::robot::mode::IDLE => 255,
        _ => 239,
    }
}

fn status_bits(robot: &Robot) -> u32 {
    let on = u32::from(robot.mode >= super::robot::mode::POWER_ON);
    on | (u32::from(robot.runtime == 2) << 1)
}

/// A field that a client can write.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Input {
    pub(crate) kind: Kind,
    pub(crate) name: String,
}

pub(crate) fn input(name: &str) -> Option<Input> {
    let kind = if indexed(name, "input_int_register_", 0, 47).is_some() {
        Kind::Int32
    } else if indexed(name, "input_double_register_", 0, 47).is_some() {
        Kind::Double
    } else if indexed(name, "input_bit_register_", 64, 127).is_some() {
        Kind::Bool
    } else {
        match name {
            "speed_slider_mask" | "input_bit_registers0_to_31" | "input_bit_registers32_to_63" => {
                Kind::Uint32
            }
            "speed_slider_fraction" | "standard_analog_output_0" | "standard_analog_output_1" => Kind::Double,
            "standard_digital_output_mask"
            | "standard_digital_output"
            | "configurable_digital_output_mask"
            | "configurable_digital_output"
            | "tool_digital_output_mask"
            | "tool_digital_output"
            | "standard_analog_output_mask"
            | "standard_analog_output_type" => Kind::Uint8,
            "external_force_torque" => Kind::Vector6,
            _ => return None,
        }
    };
    Some(Input { kind, name: name.to_owned() })
}

/// Writes the fields of one package; their sizes are those of the recipe.
pub(crate) fn apply(robot: &mut Robot, recipe: &[Input], mut bytes: &[u8]) {
    let mut masks = [0u8; 4];
    let mut slider_mask = 0u32;
    for field in recipe {
        let (raw, rest) = bytes.split_at(field.kind.size().min(bytes.len()));
        bytes = rest;
        let byte = raw.first().copied().unwrap_or(0);
        let word = || raw.try_into().map(u32::from_be_bytes).unwrap_or(0);
        let double = || raw.try_into().map(f64::from_be_bytes).unwrap_or(0.0);
        let name = field.name.as_str();
        if let Some(index) = indexed(name, "input_int_register_", 0, 47) {
            robot.inputs.ints[index] = word() as i32;
        } else if let Some(index) = indexed(name, "input_double_register_", 0, 47) {
            robot.inputs.doubles[index] = double();
        } else if let Some(index) = indexed(name, "input_bit_register_", 64, 127) {
            robot.inputs.bits[index] = byte != 0;
        }
        let set = |out: &mut u64, first: u32, mask: u8| {
            let mask = u64::from(mask) << first;
            *out = (*out & !mask) | ((u64::from(byte) << first) & mask);
        };
        match name {
            "speed_slider_mask" => slider_mask = word(),
            "speed_slider_fraction" if slider_mask == 1 && double().is_finite() => {
                robot.slider = double().clamp(0.0, 1.0);
            }
            "standard_digital_output_mask" => masks[0] = byte,
            "configurable_digital_output_mask" => masks[1] = byte,
            "tool_digital_output_mask" => masks[2] = byte,
            "standard_analog_output_mask" => masks[3] = byte,
            "standard_digital_output" => set(&mut robot.digital_out, 0, masks[0]),
            "configurable_digital_output" => set(&mut robot.digital_out, 8, masks[1]),
            "tool_digital_output" => set(&mut robot.digital_out, 16, masks[2] & 3),
            "standard_analog_output_0" if masks[3] & 1 != 0 => robot.analog_out[0] = double(),
            "standard_analog_output_1" if masks[3] & 2 != 0 => robot.analog_out[1] = double(),
            "input_bit_registers0_to_31" | "input_bit_registers32_to_63" => {
                let first = if name.ends_with("31") { 0 } else { 32 };
                let bits = word();
                for i in 0..32 {
                    robot.inputs.bits[first + i] = (bits >> i) & 1 == 1;
                }
            }
            _ => {}
        }
        robot.fed(name);
    }
}
