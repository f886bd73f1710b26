//! A connection to RTDE: negotiation, recipes, packages. Every wait is the caller's to bound.

use tokio::io::AsyncWriteExt;
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpStream, ToSocketAddrs};

use super::package::encode;
use super::{Kind, Package, PackageReader, RtdeError, TextMessage, Value};

/// Software of the controller: major, minor, bugfix, build.
pub type Version = [u32; 4];

/// Fields that are exchanged together.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recipe {
    id: u8,
    fields: Vec<(String, Kind)>,
}

impl Recipe {
    /// Names and kinds, in order.
    pub fn fields(&self) -> &[(String, Kind)] {
        &self.fields
    }

    /// Values of a package.
    ///
    /// # Errors
    /// [`RtdeError::Malformed`] for another recipe's package, or one of another size.
    pub fn decode(&self, recipe: u8, mut bytes: &[u8]) -> Result<Vec<Value>, RtdeError> {
        let wrong = |field: &str, found: String, expected: String| {
            Err(RtdeError::Malformed { field: field.into(), found, expected })
        };
        if recipe != self.id {
            return wrong("recipe of data", recipe.to_string(), self.id.to_string());
        }
        let all = bytes.len();
        let read = |(name, kind): &(String, Kind)| Value::read(*kind, name, &mut bytes);
        let values = self.fields.iter().map(read).collect::<Result<Vec<_>, _>>()?;
        if bytes.is_empty() {
            return Ok(values);
        }
        wrong("data", format!("{all} bytes"), format!("{} bytes", all - bytes.len()))
    }

    /// A package of values.
    ///
    /// # Errors
    /// [`RtdeError::Malformed`] for values that are not those of the recipe.
    pub fn encode(&self, values: &[Value]) -> Result<Vec<u8>, RtdeError> {
        let kinds: Vec<Kind> = values.iter().map(Value::kind).collect();
        if !kinds.iter().eq(self.fields.iter().map(|(_, kind)| kind)) {
            let (found, expected) = (format!("{kinds:?}"), format!("{:?}", self.fields));
            return Err(RtdeError::Malformed { field: "values to send".into(), found, expected });
        }
        let mut payload = vec![self.id];
        values.iter().for_each(|value| value.write(&mut payload));
        encode(b'U', &payload)
    }
}

/// A connection.
#[derive(Debug)]
pub struct RtdeLink {
    reader: OwnedReadHalf,
    writer: OwnedWriteHalf,
    packages: PackageReader,
    version: Version,
    texts: Vec<TextMessage>,
}

impl RtdeLink {
    /// Connects, agrees on protocol version 2, asks for the controller's version.
    ///
    /// # Errors
    /// [`RtdeError`].
    pub async fn connect(address: impl ToSocketAddrs) -> Result<Self, RtdeError> {
        let stream = TcpStream::connect(address).await?;
        stream.set_nodelay(true)?;
        let (reader, writer) = stream.into_split();
        let packages = PackageReader::default();
        let mut link = Self { reader, writer, packages, version: [0; 4], texts: Vec::new() };
        link.send(&encode(b'V', &[0, 2])?).await?;
        match link.reply("protocol version 2").await? {
            Package::ProtocolVersion(true) => {}
            Package::ProtocolVersion(false) => return Err(link.refused("protocol version 2")),
            other => return Err(unexpected("reply to protocol version", &other)),
        }
        link.send(&encode(b'v', &[])?).await?;
        match link.reply("controller version").await? {
            Package::ControllerVersion(version) => link.version = version,
            other => return Err(unexpected("reply to controller version", &other)),
        }
        Ok(link)
    }

    /// The controller's software.
    pub fn version(&self) -> Version {
        self.version
    }

    /// Asks for fields at a frequency.
    ///
    /// # Errors
    /// [`RtdeError::UnknownField`], [`RtdeError::Refused`] (a frequency out of range), others.
    pub async fn set_up_outputs(&mut self, frequency_hz: f64, names: &[&str]) -> Result<Recipe, RtdeError> {
        let mut payload = frequency_hz.to_be_bytes().to_vec();
        payload.extend(names.join(",").bytes());
        self.send(&encode(b'O', &payload)?).await?;
        match self.reply("outputs").await? {
            Package::Outputs { recipe, types } => self.recipe("outputs", names, recipe, &types),
            other => Err(unexpected("reply to outputs", &other)),
        }
    }

    /// Says which fields will be written together.
    ///
    /// # Errors
    /// [`RtdeError::UnknownField`], [`RtdeError::FieldInUse`], others.
    pub async fn set_up_inputs(&mut self, names: &[&str]) -> Result<Recipe, RtdeError> {
        self.send(&encode(b'I', names.join(",").as_bytes())?).await?;
        match self.reply("inputs").await? {
            Package::Inputs { recipe, types } => self.recipe("inputs", names, recipe, &types),
            other => Err(unexpected("reply to inputs", &other)),
        }
    }

    /// Starts the flow of outputs.
    ///
    /// # Errors
    /// [`RtdeError`].
    pub async fn start(&mut self) -> Result<(), RtdeError> {
        self.send(&encode(b'S', &[])?).await?;
        match self.reply("start").await? {
            Package::Start(true) => Ok(()),
            Package::Start(false) => Err(self.refused("start")),
            other => Err(unexpected("reply to start", &other)),
        }
    }

    /// Stops the flow of outputs.
    ///
    /// # Errors
    /// [`RtdeError`].
    pub async fn pause(&mut self) -> Result<(), RtdeError> {
        self.send(&encode(b'P', &[])?).await?;
        match self.reply("pause").await? {
            Package::Pause(true) => Ok(()),
            Package::Pause(false) => Err(self.refused("pause")),
            other => Err(unexpected("reply to pause", &other)),
        }
    }

    /// The next package. Cancel-safe: nothing is lost when the wait is given up.
    ///
    /// # Errors
    /// [`RtdeError`].
    pub async fn next(&mut self) -> Result<Package, RtdeError> {
        use tokio::io::AsyncReadExt;
        loop {
            if let Some(package) = self.packages.next_package()? {
                return Ok(package);
            }
            if self.reader.read_buf(self.packages.buffer()).await? == 0 {
                return Err(RtdeError::Link("the controller closed the connection".into()));
            }
        }
    }

    /// Sends bytes made by [`Recipe::encode`].
    ///
    /// # Errors
    /// [`RtdeError::Link`].
    pub async fn send(&mut self, bytes: &[u8]) -> Result<(), RtdeError> {
        Ok(self.writer.write_all(bytes).await?)
    }

    /// The reply to a request: data that is still under way and texts are passed over.
    async fn reply(&mut self, request: &'static str) -> Result<Package, RtdeError> {
        loop {
            match self.next().await? {
                Package::Data { .. } => {}
                Package::Text(text) => {
                    tracing::info!(request, text = text.text, source = text.source, "RTDE says");
                    if self.texts.len() < 8 {
                        self.texts.push(text);
                    }
                }
                other => return Ok(other),
            }
        }
    }

    fn refused(&mut self, request: &'static str) -> RtdeError {
        let detail = self.texts.drain(..).map(|t| format!(": {}", t.text)).collect();
        RtdeError::Refused { request, detail }
    }

    fn recipe(
        &mut self,
        request: &'static str,
        names: &[&str],
        id: u8,
        types: &[String],
    ) -> Result<Recipe, RtdeError> {
        for (name, word) in names.iter().zip(types) {
            match word.as_str() {
                "NOT_FOUND" => return Err(RtdeError::UnknownField { field: (*name).into() }),
                "IN_USE" => return Err(RtdeError::FieldInUse { field: (*name).into() }),
                _ => {}
            }
        }
        if id == 0 {
            return Err(self.refused(request));
        }
        if types.len() != names.len() {
            let (found, expected) = (format!("{} types", types.len()), names.len().to_string());
            return Err(RtdeError::Malformed { field: format!("reply to {request}"), found, expected });
        }
        let typed = names.iter().zip(types).map(|(name, word)| match Kind::from_word(word) {
            Some(kind) => Ok(((*name).to_owned(), kind)),
            None => Err(RtdeError::Malformed {
                field: format!("type of {name}"),
                found: word.clone(),
                expected: "a type of RTDE".into(),
            }),
        });
        Ok(Recipe { id, fields: typed.collect::<Result<_, _>>()? })
    }
}

fn unexpected(field: &str, found: &Package) -> RtdeError {
    let mut found = format!("{found:?}");
    found.truncate(found.char_indices().nth(80).map_or(found.len(), |(at, _)| at));
    RtdeError::Malformed { field: field.into(), found, expected: "the reply to what was asked".into() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use tokio::io::AsyncReadExt;
    use tokio::net::TcpListener;

    /// Bytes of a package: numbers in hexadecimal, and text after them.
    fn bytes(hex: &str, text: &str) -> Vec<u8> {
        let numbers = hex.split_whitespace().map(|b| u8::from_str_radix(b, 16).unwrap());
        numbers.chain(text.bytes()).collect()
    }

    #[tokio::test]
    async fn a_link_is_made_with_the_published_packages() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let controller = tokio::spawn(async move {
            let (mut stream, _) = listener.accept().await.unwrap();
            for (asked, answer) in [
                (bytes("00 05 56 00 02", ""), bytes("00 04 56 01", "")),
                (
                    bytes("00 03 76", ""),
                    bytes("00 13 76 00 00 00 05 00 00 00 11 00 00 00 03 00 00 00 00", ""),
                ),
                (
                    bytes("00 28 4F 40 5F 40 00 00 00 00 00", "timestamp,actual_q,robot_mode"),
                    bytes("00 19 4F 01", "DOUBLE,VECTOR6D,INT32"),
                ),
                (
                    bytes("00 2A 49", "speed_slider_mask,speed_slider_fraction"),
                    bytes("00 11 49 01", "UINT32,DOUBLE"),
                ),
                (bytes("00 03 53", ""), bytes("00 04 53 01", "")),
                (bytes("00 10 55 01 00 00 00 01 3F E0 00 00 00 00 00 00", ""), bytes("00 04 50 01", "")),
            ] {
                let mut found = vec![0; asked.len()];
                stream.read_exact(&mut found).await.unwrap();
                assert_eq!(found, asked);
                stream.write_all(&answer).await.unwrap();
            }
        });
        let mut link = RtdeLink::connect(address).await.unwrap();
        assert_eq!(link.version(), [5, 17, 3, 0]);
        let outputs = link.set_up_outputs(125.0, &["timestamp", "actual_q", "robot_mode"]).await.unwrap();
        let kinds: Vec<Kind> = outputs.fields().iter().map(|(_, kind)| *kind).collect();
        assert_eq!(kinds, [Kind::Double, Kind::Vector6d, Kind::Int32]);
        let inputs = link.set_up_inputs(&["speed_slider_mask", "speed_slider_fraction"]).await.unwrap();
        link.start().await.unwrap();
        link.send(&inputs.encode(&[Value::Uint32(1), Value::Double(0.5)]).unwrap()).await.unwrap();
        assert_eq!(link.next().await.unwrap(), Package::Pause(true));
        controller.await.unwrap();
    }

    proptest! {
        #[test]
        fn any_data_is_survived_by_any_recipe(
            kinds in prop::collection::vec(0usize..10, 0..8), id in 0u8..3,
            bytes in prop::collection::vec(any::<u8>(), 0..120)
        ) {
            let fields = kinds.iter().map(|kind| ("f".to_owned(), Kind::WORDS[*kind].0)).collect();
            let recipe = Recipe { id: 1, fields };
            if let Ok(values) = recipe.decode(id, &bytes) {
                prop_assert_eq!(id, 1);
                prop_assert_eq!(bytes.len(), values.iter().map(|v| v.kind().size()).sum::<usize>());
                prop_assert_eq!(&recipe.encode(&values).unwrap()[4..], &bytes[..]);
            }
        }
    }

    #[test]
    fn the_published_data_package_is_read() {
        let fields = [("timestamp", Kind::Double), ("actual_q", Kind::Vector6d), ("robot_mode", Kind::Int32)];
        let recipe = Recipe { id: 1, fields: fields.map(|(n, k)| (n.to_owned(), k)).to_vec() };
        let mut bytes = vec![0x3f, 0xf8, 0, 0, 0, 0, 0, 0];
        (1..=6).for_each(|i| bytes.extend(f64::from(i).to_be_bytes()));
        bytes.extend([0, 0, 0, 7]);
        assert_eq!(bytes.len() + 4, 64);
        let values = recipe.decode(1, &bytes).unwrap();
        let q = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        assert_eq!(values, [Value::Double(1.5), Value::Vector6d(q), Value::Int32(7)]);
        assert!(recipe.decode(2, &bytes).unwrap_err().to_string().contains("found 2, expected 1"));
        bytes.push(0);
        let error = recipe.decode(1, &bytes).unwrap_err().to_string();
        assert!(error.contains("found 61 bytes, expected 60 bytes"), "{error}");
        assert!(recipe.encode(&[Value::Bool(true)]).is_err());
        let package = recipe.encode(&values).unwrap();
        assert_eq!((package.len(), &package[..4]), (64, &[0x00, 0x40, 0x55, 0x01][..]));
    }
}
