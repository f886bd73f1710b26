//! From an ONNX graph to layers: every sum and every activation is folded into the convolution before it.

use std::collections::HashMap;

use crate::error::ModelError;
use crate::kernel::{CHUNK, Isa};
use crate::layer::{Conv, Head, Layer, Slot, Walk, loaded, pack};
use crate::onnx::{Attribute, FLOAT, Graph, INT64, Node, Tensor};
use crate::tensor::Shape;

/// Most channels of a tensor; limits what a hostile file can ask for.
const MAX_CHANNELS: usize = 1024;
/// Most nodes of a graph.
const MAX_NODES: usize = 1000;
/// Most numbers in all activations together: two gigabytes.
const MAX_ACTIVATIONS: usize = 1 << 29;

/// A network as it is run.
#[derive(Debug)]
pub(crate) struct Plan {
    pub(crate) layers: Vec<Layer>,
    pub(crate) head: Head,
    /// Where each slot's activations lie.
    pub(crate) shapes: Vec<Shape>,
    /// Slots that the volume is laid out in, with the voxels along a cell's edge.
    pub(crate) volumes: Vec<(Slot, usize)>,
}

/// What is known of a named value while the graph is read.
#[derive(Debug, Clone, Copy)]
enum Value {
    /// The network's input.
    Volume,
    /// Activations.
    Slot(Slot),
    /// One of the parts that the answer was split into, and whether it went through a sigmoid.
    Part(usize, bool),
}

struct Compiler<'a> {
    isa: Isa,
    side: usize,
    weights: HashMap<&'a str, &'a Tensor>,
    values: HashMap<&'a str, Value>,
    /// How often each name is read.
    uses: HashMap<&'a str, usize>,
    layers: Vec<Layer>,
    head: Option<Head>,
    shapes: Vec<Shape>,
    volumes: Vec<(Slot, usize)>,
    numbers: usize,
}

/// Compiles a graph whose input has `side`³ voxels and whose orientation has `numbers` numbers.
pub(crate) fn compile(graph: &Graph, side: usize, numbers: usize, isa: Isa) -> Result<Plan, ModelError> {
    let mut uses = HashMap::new();
    for input in graph.nodes.iter().flat_map(|n| &n.inputs) {
        *uses.entry(input.as_str()).or_insert(0) += 1;
    }
    let mut compiler = Compiler {
        isa,
        side,
        weights: graph.weights.iter().map(|w| (w.name.as_str(), w)).collect(),
        values: HashMap::from([("volume", Value::Volume)]),
        uses,
        layers: Vec::new(),
        head: None,
        shapes: Vec::new(),
        volumes: Vec::new(),
        numbers,
    };
    for (i, node) in graph.nodes.iter().enumerate() {
        if i == MAX_NODES {
            return Err(wrong(node, format!("{} nodes", graph.nodes.len()), format!("at most {MAX_NODES}")));
        }
        compiler.node(graph, i, node)?;
        let activations: usize = compiler.shapes.iter().map(|s| Shape { margin: 1, ..*s }.len()).sum();
        if activations > MAX_ACTIVATIONS {
            let expected = format!("at most {MAX_ACTIVATIONS}");
            return Err(wrong(node, format!("{activations} activations up to here"), expected));
        }
    }
    compiler.finish()
}

fn wrong(node: &Node, found: impl Into<String>, expected: impl Into<String>) -> ModelError {
    ModelError::Operator { node: node.name.clone(), found: found.into(), expected: expected.into() }
}

/// A size that all three axes share.
fn cubic(node: &Node, name: &str, all: usize, default: usize) -> Result<usize, ModelError> {
    let Some(attribute) = attribute(node, name) else { return Ok(default) };
    let values = &attribute.integers;
    match values.first() {
        Some(&v) if values.len() == all && values.iter().all(|w| *w == v) && (0..=16).contains(&v) => {
            Ok(v as usize)
        }
        _ => Err(wrong(node, format!("{name} {values:?}"), format!("{all} equal numbers from 0 to 16"))),
    }
}

fn attribute<'a>(node: &'a Node, name: &str) -> Option<&'a Attribute> {
    node.attributes.iter().find(|a| a.name == name)
}

/// A weight's dimensions and numbers.
struct Weight {
    dims: Vec<usize>,
    values: Vec<f32>,
}

impl<'a> Compiler<'a> {
    fn node(&mut self, graph: &'a Graph, index: usize, node: &'a Node) -> Result<(), ModelError> {
        let result = match node.operator.as_str() {
            "Conv" | "ConvTranspose" if self.is_answer(graph, index, node) => {
                self.head(node)?;
                return Ok(());
            }
            "Conv" | "ConvTranspose" => self.convolution(node)?,
            "Relu" => self.relu(node)?,
            "Add" => self.add(node)?,
            "MaxPool" => self.pool(node)?,
            "Concat" => self.concat(node)?,
            "Split" => return self.split(node),
            "Sigmoid" => self.sigmoid(node)?,
            other => {
                let known = "Conv, ConvTranspose, Relu, Add, MaxPool, Concat, Split or Sigmoid";
                return Err(wrong(node, format!("operator `{other}`"), known));
            }
        };
        let [output] = &node.outputs[..] else {
            return Err(wrong(node, format!("{} outputs", node.outputs.len()), "one"));
        };
        self.values.insert(output, result);
        Ok(())
    }

    /// Whether a convolution's result is what the next node splits into the outputs.
    fn is_answer(&self, graph: &Graph, index: usize, node: &Node) -> bool {
        let next = graph.nodes.get(index + 1);
        next.is_some_and(|n| n.operator == "Split" && n.inputs.first() == node.outputs.first())
    }

    fn value(&self, node: &'a Node, input: usize) -> Result<(&'a str, Value), ModelError> {
        let name = node.inputs.get(input).map(String::as_str).unwrap_or_default();
        match self.values.get(name) {
            Some(value) => Ok((name, *value)),
            None => {
                Err(wrong(node, format!("input `{name}`"), "the name of a value that was computed before"))
            }
        }
    }

    /// Activations that a node reads.
    fn slot(&self, node: &'a Node, input: usize) -> Result<(&'a str, Slot, Shape), ModelError> {
        match self.value(node, input)? {
            (name, Value::Slot(slot)) => Ok((name, slot, self.shapes[slot])),
            (name, _) => Err(wrong(node, format!("input `{name}`"), "the result of a convolution or a pool")),
        }
    }

    fn weight(&self, node: &Node, input: usize, rank: usize) -> Result<Weight, ModelError> {
        let name = node.inputs.get(input).map(String::as_str).unwrap_or_default();
        let expected = format!("a weight of {rank} dimensions in 32-bit floating-point numbers");
        let Some(tensor) = self.weights.get(name) else {
            return Err(wrong(node, format!("no weight `{name}`"), expected));
        };
        let dims: Option<Vec<usize>> = tensor
            .dims
            .iter()
            .map(|d| usize::try_from(*d).ok().filter(|d| (1..=MAX_CHANNELS).contains(d)))
            .collect();
        let Some(dims) = dims.filter(|d| d.len() == rank && tensor.kind == FLOAT) else {
            let found = format!("weight `{name}` of type {} and dimensions {:?}", tensor.kind, tensor.dims);
            return Err(wrong(node, found, expected));
        };
        let (numbers, rest) = tensor.raw.as_chunks::<4>();
        let count = dims.iter().try_fold(1usize, |n, d| n.checked_mul(*d));
        if Some(numbers.len()) != count || !rest.is_empty() {
            let found = format!("weight `{name}` of {} bytes", tensor.raw.len());
            return Err(wrong(node, found, format!("{dims:?} numbers of 4 bytes")));
        }
        let values: Vec<f32> = numbers.iter().map(|b| f32::from_le_bytes(*b)).collect();
        if let Some(value) = values.iter().find(|v| !v.is_finite()) {
            return Err(wrong(node, format!("{value} in weight `{name}`"), "finite numbers"));
        }
        Ok(Weight { dims, values })
    }

    /// Weight and bias of a convolution, with the checked kernel size.
    fn parameters(&self, node: &Node, outputs_at: usize) -> Result<(Weight, Vec<f32>, usize), ModelError> {
        let weight = self.weight(node, 1, 5)?;
        let kernel = weight.dims[2];
        if weight.dims[3..] != [kernel; 2] || cubic(node, "kernel_shape", 3, kernel)? != kernel || kernel > 8
        {
            return Err(wrong(node, format!("a kernel of {:?}", &weight.dims[2..]), "a cube of at most 8³"));
        }
        for name in ["group", "dilations", "auto_pad", "output_padding"] {
            let plain = attribute(node, name)
                .is_none_or(|a| name != "auto_pad" && a.integer <= 1 && a.integers.iter().all(|i| *i == 1));
            if !plain {
                return Err(wrong(node, format!("attribute {name}"), "a plain convolution"));
            }
        }
        let outputs = weight.dims[outputs_at];
        let bias = match node.inputs.len() {
            2 => vec![0.0; outputs],
            _ => self.weight(node, 2, 1)?.values,
        };
        if bias.len() != outputs {
            return Err(wrong(node, format!("{} biases", bias.len()), format!("{outputs}")));
        }
        Ok((weight, bias, kernel))
    }

    fn new_slot(&mut self, shape: Shape) -> Slot {
        self.shapes.push(shape);
        self.shapes.len() - 1
    }

    /// The slot of the volume laid out in cells of `block`³ voxels.
    fn volume_slot(&mut self, block: usize) -> Slot {
        if let Some((slot, _)) = self.volumes.iter().find(|(_, b)| *b == block) {
            return *slot;
        }
        let slot = self.new_slot(loaded(self.side, block));
        self.volumes.push((slot, block));
        slot
    }

    fn convolution(&mut self, node: &'a Node) -> Result<Value, ModelError> {
        if node.operator == "ConvTranspose" {
            return self.transposed(node);
        }
        let (weight, bias, mut kernel) = self.parameters(node, 0)?;
        let mut stride = cubic(node, "strides", 3, 1)?;
        let mut pad = cubic(node, "pads", 6, 0)?;
        let (outputs, mut inputs) = (weight.dims[0], weight.dims[1]);
        let full = kernel;
        // Of a volume: two by two by two voxels become eight channels where that covers the same voxels.
        let mut block = 1;
        let input = match self.value(node, 0)?.1 {
            Value::Volume => {
                if stride == 2
                    && kernel % 2 == 0
                    && pad % 2 == 0
                    && self.side.is_multiple_of(2)
                    && inputs == 1
                {
                    (block, kernel, stride, pad, inputs) = (2, kernel / 2, 1, pad / 2, 8);
                }
                self.volume_slot(block)
            }
            _ => self.slot(node, 0)?.1,
        };
        let shape = self.shapes[input];
        let same = stride == 1 && kernel == 2 * pad + 1;
        let halved = pad == 0 && stride == kernel && stride > 1 && shape.side.is_multiple_of(stride);
        if !(same || halved) || shape.channels != inputs {
            let found = format!(
                "{} channels of {}³ under a kernel of {inputs} × {kernel}³, stride {stride}, pad {pad}",
                shape.channels, shape.side
            );
            return Err(wrong(node, found, "a convolution that keeps the size, or divides it by its kernel"));
        }
        self.shapes[input].margin = shape.margin.max(pad);
        // The volume's block is part of its kernel: tap a, voxel d within the cell is tap a·block + d.
        let value = |output: usize, row: usize, k: usize| {
            let (channel, dz) = (k % shape.stride, k / shape.stride);
            let (dx, dy) = (row / kernel, row % kernel);
            let (cx, cy, cz, source) = match block {
                2 => (channel / 4, channel / 2 % 2, channel % 2, 0),
                _ => (0, 0, 0, channel),
            };
            if channel >= inputs {
                return 0.0;
            }
            let tap = ((dx * block + cx) * full + dy * block + cy) * full + dz * block + cz;
            weight.values[(output * weight.dims[1] + source) * full.pow(3) + tap]
        };
        let groups = pack(self.isa, outputs, kernel * kernel, kernel * shape.stride, value, |o| bias[o]);
        let output = self.new_slot(Shape::new(shape.side / stride, outputs));
        let walk = Walk::Window { kernel, stride, pad };
        self.layers.push(Layer::Conv(Conv {
            input,
            output,
            residual: None,
            relu: false,
            walk,
            parts: vec![groups],
        }));
        Ok(Value::Slot(output))
    }

    fn transposed(&mut self, node: &'a Node) -> Result<Value, ModelError> {
        let (weight, bias, shape, input) = self.spreading(node)?;
        let (inputs, outputs) = (weight.dims[0], weight.dims[1]);
        let parts = (0..8)
            .map(|place| {
                let value = |output: usize, _: usize, channel: usize| match channel < inputs {
                    true => weight.values[(channel * outputs + output) * 8 + place],
                    false => 0.0,
                };
                pack(self.isa, outputs, 1, shape.stride, value, |o| bias[o])
            })
            .collect();
        let output = self.new_slot(Shape::new(2 * shape.side, outputs));
        self.layers.push(Layer::Conv(Conv {
            input,
            output,
            residual: None,
            relu: false,
            walk: Walk::Spread,
            parts,
        }));
        Ok(Value::Slot(output))
    }

    /// Weight, bias and input of a transposed convolution that makes 2³ cells of one.
    fn spreading(&self, node: &'a Node) -> Result<(Weight, Vec<f32>, Shape, Slot), ModelError> {
        let (weight, bias, kernel) = self.parameters(node, 1)?;
        let (_, input, shape) = self.slot(node, 0)?;
        let (stride, pad) = (cubic(node, "strides", 3, 1)?, cubic(node, "pads", 6, 0)?);
        if [kernel, stride, pad] != [2, 2, 0]
            || weight.dims[0] != shape.channels
            || shape.side > 4 * self.side
        {
            let found = format!(
                "a transposed convolution of {} × {kernel}³, stride {stride}, pad {pad} on {} channels of {}³",
                weight.dims[0], shape.channels, shape.side
            );
            return Err(wrong(node, found, "kernel 2³, stride 2 and no pad on as many channels"));
        }
        Ok((weight, bias, shape, input))
    }

    /// The convolution whose result is split into scores and orientation.
    fn head(&mut self, node: &'a Node) -> Result<(), ModelError> {
        let transposed = node.operator == "ConvTranspose";
        let (weight, bias, shape, input, shuffle) = if transposed {
            let (weight, bias, shape, input) = self.spreading(node)?;
            (weight, bias, shape, input, 2)
        } else {
            let (weight, bias, kernel) = self.parameters(node, 0)?;
            let (_, input, shape) = self.slot(node, 0)?;
            let (stride, pad) = (cubic(node, "strides", 3, 1)?, cubic(node, "pads", 6, 0)?);
            if [kernel, stride, pad] != [1, 1, 0] || weight.dims[1] != shape.channels {
                let found = format!("{:?}, stride {stride}, pad {pad}", weight.dims);
                return Err(wrong(node, found, format!("a kernel of {} × 1³", shape.channels)));
            }
            (weight, bias, shape, input, 1)
        };
        let channels = 2 + self.numbers;
        let (answers, cells) = (bias.len(), shape.side * shuffle);
        if answers != channels || cells != self.side {
            let found = format!("{answers} channels of {cells}³ voxels");
            return Err(wrong(node, found, format!("{channels} of {}³", self.side)));
        }
        let places = if transposed { 8 } else { 1 };
        let value = |output: usize, _: usize, channel: usize| {
            let (place, answer) = (output / channels, output % channels);
            match (channel < shape.channels, transposed) {
                (false, _) => 0.0,
                (true, true) => weight.values[(channel * channels + answer) * 8 + place],
                (true, false) => weight.values[answer * shape.channels + channel],
            }
        };
        let groups = pack(self.isa, places * channels, 1, shape.stride, value, |o| bias[o % channels]);
        self.head = Some(Head { input, shuffle, numbers: self.numbers, groups });
        Ok(())
    }

    /// The layer that made a slot, if nobody else reads it.
    fn maker(&mut self, name: &str, slot: Slot) -> Option<(usize, &mut Conv)> {
        if self.uses.get(name) != Some(&1) {
            return None;
        }
        self.layers.iter_mut().enumerate().find_map(|(i, layer)| match layer {
            Layer::Conv(conv) if conv.output == slot => Some((i, conv)),
            _ => None,
        })
    }

    fn relu(&mut self, node: &'a Node) -> Result<Value, ModelError> {
        let (name, slot, _) = self.slot(node, 0)?;
        match self.maker(name, slot) {
            Some((_, conv)) if !conv.relu => conv.relu = true,
            _ => {
                return Err(wrong(
                    node,
                    "Relu",
                    "Relu right after a convolution or a sum that nobody else reads",
                ));
            }
        }
        Ok(Value::Slot(slot))
    }

    fn add(&mut self, node: &'a Node) -> Result<Value, ModelError> {
        let (a, b) = (self.slot(node, 0)?, self.slot(node, 1)?);
        if (a.2.side, a.2.channels) != (b.2.side, b.2.channels) {
            let found = format!("{} × {}³ plus {} × {}³", a.2.channels, a.2.side, b.2.channels, b.2.side);
            return Err(wrong(node, found, "equal shapes"));
        }
        // Whichever convolution comes later can add what the other one left; a sum itself is no place to add to.
        let free = |made: Option<(usize, &mut Conv)>| {
            made.filter(|(_, c)| !c.relu && c.residual.is_none()).map(|m| m.0)
        };
        let later = [(free(self.maker(a.0, a.1)), a.1, b.1), (free(self.maker(b.0, b.1)), b.1, a.1)];
        let Some((Some(layer), sum, other)) = later.into_iter().max_by_key(|(layer, ..)| *layer) else {
            return Err(wrong(
                node,
                "Add",
                "a sum of which one part is a convolution that nobody else reads",
            ));
        };
        let made_before = self.layers[..layer].iter().any(|l| match l {
            Layer::Conv(c) => c.output == other,
            Layer::Pool { output, .. } | Layer::Concat { output, .. } => *output == other,
        });
        match &mut self.layers[layer] {
            Layer::Conv(conv) if made_before => conv.residual = Some(other),
            _ => return Err(wrong(node, "Add", "a sum whose other part was computed before")),
        }
        Ok(Value::Slot(sum))
    }

    fn pool(&mut self, node: &'a Node) -> Result<Value, ModelError> {
        let (_, input, shape) = self.slot(node, 0)?;
        let (kernel, stride) = (cubic(node, "kernel_shape", 3, 0)?, cubic(node, "strides", 3, 1)?);
        if [kernel, stride, cubic(node, "pads", 6, 0)?, shape.side % 2] != [2, 2, 0, 0] {
            return Err(wrong(
                node,
                format!("MaxPool of {kernel}³ on {}³", shape.side),
                "2³ with stride 2, even sizes",
            ));
        }
        let output = self.new_slot(Shape { side: shape.side / 2, margin: 0, ..shape });
        self.layers.push(Layer::Pool { input, output });
        Ok(Value::Slot(output))
    }

    fn concat(&mut self, node: &'a Node) -> Result<Value, ModelError> {
        let (a, b) = (self.slot(node, 0)?, self.slot(node, 1)?);
        if node.inputs.len() != 2
            || a.2.side != b.2.side
            || attribute(node, "axis").map(|a| a.integer) != Some(1)
        {
            return Err(wrong(node, "Concat", "the channels of two tensors of one size"));
        }
        let output = self.new_slot(Shape::new(a.2.side, a.2.channels + b.2.channels));
        self.layers.push(Layer::Concat { inputs: [a.1, b.1], output });
        Ok(Value::Slot(output))
    }

    /// Names the parts of the answer.
    fn split(&mut self, node: &'a Node) -> Result<(), ModelError> {
        let sizes = node.inputs.get(1).and_then(|name| self.weights.get(name.as_str()));
        let found = sizes.filter(|s| s.kind == INT64).map(|s| s.raw.as_chunks::<8>().0);
        let found: Vec<i64> = found.unwrap_or_default().iter().map(|b| i64::from_le_bytes(*b)).collect();
        if self.head.is_none() || found != [1, 1, self.numbers as i64] || node.outputs.len() != 3 {
            let expected = format!("the last convolution split into 1, 1 and {} channels", self.numbers);
            return Err(wrong(node, format!("Split into {found:?}"), expected));
        }
        for (part, name) in node.outputs.iter().enumerate() {
            self.values.insert(name, Value::Part(part, false));
        }
        Ok(())
    }

    fn sigmoid(&mut self, node: &'a Node) -> Result<Value, ModelError> {
        match self.value(node, 0)? {
            (_, Value::Part(part @ 0..2, false)) => Ok(Value::Part(part, true)),
            (name, _) => Err(wrong(node, format!("Sigmoid of `{name}`"), "Sigmoid of a score, at the end")),
        }
    }

    /// Checks that the outputs are what they are called.
    fn finish(self) -> Result<Plan, ModelError> {
        for (output, part, sigmoid) in
            [("certainty", 0, true), ("centroid", 1, true), ("orientation", 2, false)]
        {
            match self.values.get(output) {
                Some(Value::Part(p, s)) if (*p, *s) == (part, sigmoid) => {}
                _ => return Err(ModelError::Output { output }),
            }
        }
        let Some(head) = self.head else { return Err(ModelError::Output { output: "certainty" }) };
        debug_assert!(self.shapes.iter().all(|s| s.stride % CHUNK == 0));
        Ok(Plan { layers: self.layers, head, shapes: self.shapes, volumes: self.volumes })
    }
}
