//! Reads user values, from JSON or a query, into types. A fault names its location and the expected
//! type in JSON terms, not Rust's.

use std::fmt::{self, Display};

use serde::de::value::{MapDeserializer, SeqDeserializer};
use serde::de::{self, DeserializeOwned, Deserializer, IntoDeserializer, Unexpected, Visitor};
use serde::forward_to_deserialize_any;
use serde_json::{Map, Value};

/// A fault in a value.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Fault {
    /// JSON pointer (RFC 6901) to its location; empty for the whole value.
    pub pointer: String,
    /// The rest of a sentence about it, such as "must be a string".
    pub words: String,
}

/// Reads a JSON value.
///
/// # Errors
/// [`Fault`] at the first place that does not fit the type.
pub fn read<T: DeserializeOwned>(value: Value) -> Result<T, Fault> {
    T::deserialize(Given { value, key: None, is_text: false })
}

/// Reads the pairs of a query, whose numbers are strings.
///
/// # Errors
/// [`Fault`] at a pair that does not fit the type, or whose key is duplicated.
pub fn read_pairs<T: DeserializeOwned>(pairs: Vec<(String, String)>) -> Result<T, Fault> {
    let mut fields = Map::new();
    for (key, text) in pairs {
        let pointer = below(&key, "");
        if fields.insert(key, Value::String(text)).is_some() {
            let words = "must not appear twice".to_owned();
            return Err(Fault { pointer, words });
        }
    }
    T::deserialize(Given { value: Value::Object(fields), key: None, is_text: true })
}

/// A JSON pointer to the location `rest` below `key`.
pub fn below(key: &str, rest: &str) -> String {
    let key = key.replace('~', "~0").replace('/', "~1");
    format!("/{key}{rest}")
}

impl Fault {
    /// A value of the wrong type; the caller names the expected one.
    fn of_type() -> Self {
        Self::default()
    }

    fn of(words: impl Display) -> Self {
        Self { pointer: String::new(), words: words.to_string() }
    }
}

impl Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.pointer.strip_prefix('/') {
            Some(place) => write!(f, "`{place}` {}", self.words),
            None => write!(f, "it {}", self.words),
        }
    }
}

impl std::error::Error for Fault {}

impl de::Error for Fault {
    fn custom<T: Display>(message: T) -> Self {
        Self::of(message)
    }

    fn invalid_type(_: Unexpected<'_>, _: &dyn de::Expected) -> Self {
        Self::of_type()
    }

    fn invalid_value(_: Unexpected<'_>, _: &dyn de::Expected) -> Self {
        Self::of_type()
    }

    fn invalid_length(_: usize, _: &dyn de::Expected) -> Self {
        Self::of_type()
    }

    fn unknown_variant(_: &str, known: &'static [&'static str]) -> Self {
        Self::of(format_args!("must be {}", one_of(known)))
    }

    fn unknown_field(field: &str, known: &'static [&'static str]) -> Self {
        Self { pointer: below(field, ""), words: format!("is unknown; use {}", one_of(known)) }
    }

    fn missing_field(field: &'static str) -> Self {
        Self { pointer: below(field, ""), words: "is missing".to_owned() }
    }
}

fn one_of(known: &[&str]) -> String {
    let known: Vec<_> = known.iter().map(|word| format!("`{word}`")).collect();
    match known.as_slice() {
        [one] => one.clone(),
        known => format!("one of {}", known.join(", ")),
    }
}

/// A value with its key in the enclosing value.
struct Given {
    value: Value,
    key: Option<String>,
    /// Whether a number is given as a string.
    is_text: bool,
}

impl Given {
    fn visit<'de, V: Visitor<'de>>(
        self,
        visitor: V,
        wanted: impl Display,
    ) -> Result<V::Value, Fault> {
        let is_text = self.is_text;
        let within = |key, value| Self { value, key: Some(key), is_text };
        let outcome = match self.value {
            Value::Null => visitor.visit_unit(),
            Value::Bool(value) => visitor.visit_bool(value),
            Value::Number(number) => match (number.as_u64(), number.as_i64(), number.as_f64()) {
                (Some(value), ..) => visitor.visit_u64(value),
                (_, Some(value), _) => visitor.visit_i64(value),
                (.., value) => visitor.visit_f64(value.unwrap_or(f64::NAN)),
            },
            Value::String(text) => visitor.visit_string(text),
            Value::Array(items) => {
                let items = items.into_iter().enumerate();
                let items = items.map(|(at, value)| within(at.to_string(), value));
                let mut items = SeqDeserializer::new(items);
                let all = visitor.visit_seq(&mut items);
                all.and_then(|all| items.end().map(|()| all))
            }
            Value::Object(fields) => {
                let fields = fields.into_iter();
                let fields = fields.map(|(key, value)| (key.clone(), within(key, value)));
                visitor.visit_map(MapDeserializer::new(fields))
            }
        };
        outcome.map_err(|fault| Fault {
            words: match fault.words.as_str() {
                "" => format!("must be {wanted}"),
                _ => fault.words,
            },
            pointer: match &self.key {
                Some(key) => below(key, &fault.pointer),
                None => fault.pointer,
            },
        })
    }

    fn visit_number<'de, V: Visitor<'de>>(
        mut self,
        visitor: V,
        wanted: impl Display,
    ) -> Result<V::Value, Fault> {
        if let (true, Value::String(text)) = (self.is_text, &self.value) {
            let whole = text.parse::<u64>().map(Value::from);
            let whole = whole.or_else(|_| text.parse::<i64>().map(Value::from));
            let number = whole.or_else(|_| text.parse::<f64>().map(Value::from));
            // Text that is not a number becomes null, which is not a number either.
            self.value = number.unwrap_or_default();
        }
        self.visit(visitor, wanted)
    }
}

impl<'de> IntoDeserializer<'de, Fault> for Given {
    type Deserializer = Self;

    fn into_deserializer(self) -> Self {
        self
    }
}

/// Methods that read numbers, with their expected types.
macro_rules! numbers {
    ($($method:ident: $wanted:expr,)*) => {$(
        fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
            self.visit_number(visitor, $wanted)
        }
    )*};
}

/// Methods that read other types.
macro_rules! others {
    ($($method:ident: $wanted:expr,)*) => {$(
        fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
            self.visit(visitor, $wanted)
        }
    )*};
}

macro_rules! whole {
    ($type:ty) => {
        format_args!("a whole number from {} to {}", <$type>::MIN, <$type>::MAX)
    };
}

impl<'de> Deserializer<'de> for Given {
    type Error = Fault;

    numbers! {
        deserialize_u8: whole!(u8),
        deserialize_u16: whole!(u16),
        deserialize_u32: whole!(u32),
        deserialize_u64: whole!(u64),
        deserialize_i8: whole!(i8),
        deserialize_i16: whole!(i16),
        deserialize_i32: whole!(i32),
        deserialize_i64: whole!(i64),
        deserialize_f32: "a number",
        deserialize_f64: "a number",
    }

    others! {
        deserialize_any: "of another type",
        deserialize_bool: "true or false",
        deserialize_str: "a string",
        deserialize_string: "a string",
        deserialize_seq: "an array",
        deserialize_map: "an object",
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        match self.value {
            Value::Null => visitor.visit_none(),
            _ => visitor.visit_some(self),
        }
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, Fault> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_tuple<V: Visitor<'de>>(
        self,
        length: usize,
        visitor: V,
    ) -> Result<V::Value, Fault> {
        self.visit(visitor, format_args!("an array of {length}"))
    }

    fn deserialize_struct<V: Visitor<'de>>(
        mut self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Fault> {
        // Otherwise serde accepts an array for a struct, field by field.
        if self.value.is_array() {
            self.value = Value::Null;
        }
        self.visit(visitor, "an object")
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        known: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Fault> {
        struct Variant<V>(V);

        impl<'de, V: Visitor<'de>> Visitor<'de> for Variant<V> {
            type Value = V::Value;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.expecting(f)
            }

            fn visit_str<E: de::Error>(self, text: &str) -> Result<V::Value, E> {
                self.0.visit_enum(text.into_deserializer())
            }
        }

        self.visit(Variant(visitor), one_of(known))
    }

    forward_to_deserialize_any! {
        i128 u128 char bytes byte_buf unit unit_struct tuple_struct identifier ignored_any
    }
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;
    use serde_json::json;

    use super::*;

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(rename_all = "snake_case")]
    enum Kind {
        Near,
        Far,
    }

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Lens {
        focal: f64,
        kind: Option<Kind>,
    }

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Camera {
        name: String,
        #[serde(default)]
        count: u8,
        lenses: Option<Vec<Lens>>,
        row: Option<[f64; 2]>,
    }

    #[test]
    fn fitting_values_are_read() {
        let camera = json!({ "name": "a", "lenses": [{ "focal": 2, "kind": "far" }] });
        let lens = Lens { focal: 2.0, kind: Some(Kind::Far) };
        let wanted = Camera { name: "a".to_owned(), count: 0, lenses: Some(vec![lens]), row: None };
        assert_eq!(read(camera), Ok(wanted));
    }

    #[test]
    fn a_fault_names_its_location_and_the_expected_type() {
        let lens = |lens: Value| json!({ "name": "a", "lenses": [{ "focal": 1 }, lens] });
        for (value, message) in [
            (json!([]), "it must be an object"),
            (json!(["a", 1, null, null]), "it must be an object"),
            (json!({}), "`name` is missing"),
            (json!({ "name": 1 }), "`name` must be a string"),
            (json!({ "name": "a", "count": -1 }), "`count` must be a whole number from 0 to 255"),
            (json!({ "name": "a", "count": 1.5 }), "`count` must be a whole number from 0 to 255"),
            (
                json!({ "name": "a", "a/b": 1 }),
                "`a~1b` is unknown; use one of `name`, `count`, `lenses`, `row`",
            ),
            (json!({ "name": "a", "lenses": 1 }), "`lenses` must be an array"),
            (json!({ "name": "a", "row": [1] }), "`row` must be an array of 2"),
            (json!({ "name": "a", "row": [1, 2, 3] }), "`row` must be an array of 2"),
            (json!({ "name": "a", "row": [1, "2"] }), "`row/1` must be a number"),
            (lens(json!({ "focal": "wide" })), "`lenses/1/focal` must be a number"),
            (lens(json!({})), "`lenses/1/focal` is missing"),
            (
                lens(json!({ "focal": 1, "kind": "wide" })),
                "`lenses/1/kind` must be one of `near`, `far`",
            ),
            (
                lens(json!({ "focal": 1, "kind": 3 })),
                "`lenses/1/kind` must be one of `near`, `far`",
            ),
        ] {
            let fault = read::<Camera>(value).expect_err(message);
            assert_eq!(fault.to_string(), message);
        }
    }

    #[test]
    fn query_numbers_are_strings() {
        let pairs = |pairs: &[(&str, &str)]| {
            let owned = |(key, text): &(&str, &str)| ((*key).to_owned(), (*text).to_owned());
            pairs.iter().map(owned).collect::<Vec<_>>()
        };
        let lens = read_pairs::<Lens>(pairs(&[("focal", "-2e1"), ("kind", "near")]));
        assert_eq!(lens.expect("read").focal, -20.0);
        let camera = read_pairs::<Camera>(pairs(&[("name", "7"), ("count", "7")]));
        assert_eq!(camera.map(|camera| (camera.name, camera.count)), Ok(("7".to_owned(), 7)));
        for (wrong, message) in [
            (&[("focal", "NaN")][..], "`focal` must be a number"),
            (&[("focal", "")], "`focal` must be a number"),
            (&[("focal", "1"), ("focal", "1")], "`focal` must not appear twice"),
            (&[("fokal", "1")], "`fokal` is unknown; use one of `focal`, `kind`"),
        ] {
            let fault = read_pairs::<Lens>(pairs(wrong)).expect_err(message);
            assert_eq!(fault.to_string(), message);
        }
    }
}
