//! Typed settings: a struct whose fields are settings, and enums whose values are words.

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::schema::{Problem, Setting, Shape, Values, WordAbout};

/// A struct of settings.
pub trait Group: Default {
    /// Its settings, in the order of its fields.
    fn schema() -> Vec<Setting>;

    /// Reads the settings; other names are ignored.
    ///
    /// # Errors
    /// A value that the setting does not allow.
    fn read(values: &Values) -> Result<Self, Problem>;

    /// Adds the settings to `values`.
    fn write(&self, values: &mut Values);

    /// Its settings with these values as their defaults.
    #[must_use]
    fn as_defaults(&self) -> Vec<Setting> {
        let mut values = Values::new();
        self.write(&mut values);
        let with_default = |setting: Setting| match values.remove(&setting.name) {
            Some(default) => Setting { default, ..setting },
            None => setting,
        };
        Self::schema().into_iter().map(with_default).collect()
    }
}

/// An enum whose values are words.
pub trait Words: Sized + Copy + 'static {
    /// Every value with its word and meaning.
    const ALL: &'static [Word<Self>];

    /// The word of this value.
    fn as_str(self) -> &'static str;

    /// The shape of a setting that has one of the words.
    #[must_use]
    fn shape() -> Shape {
        let about = |word: &Word<Self>| WordAbout { word: word.value.as_str().to_owned(), about: text(&[word.about]) };
        Shape::Word { words: Self::ALL.iter().map(about).collect() }
    }
}

/// A value of an enum, with its meaning.
#[derive(Debug, Clone, Copy)]
pub struct Word<T> {
    /// The value.
    pub value: T,
    /// Its meaning.
    pub about: &'static str,
}

/// The setting `name` of `values`, checked; its default where it is left out.
///
/// # Errors
/// A value that the setting does not allow.
pub fn take<T: DeserializeOwned>(values: &Values, setting: &Setting) -> Result<T, Problem> {
    let value = match values.get(&setting.name) {
        None | Some(Value::Null) => setting.default.clone(),
        Some(given) => setting.check(given)?,
    };
    serde_json::from_value(value).map_err(|error| Problem::new(&setting.name, error.to_string()))
}

/// A setting's value as JSON. Numbers, words and lists of them always have that form.
#[must_use]
pub fn json<T: Serialize>(value: &T) -> Value {
    serde_json::to_value(value).unwrap_or_default()
}

/// The lines of a doc comment as one text.
#[must_use]
pub fn text(lines: &[&str]) -> String {
    lines.iter().map(|line| line.trim()).collect::<Vec<_>>().join(" ")
}

/// Defines a struct of settings: each field with its documentation, type, default and [`Shape`].
///
/// ```
/// gleaner_core::settings! {
///     /// A network.
///     pub struct Network {
///         /// Values in the hidden layer.
///         pub hidden: u32 = 256, gleaner_core::schema::integer_in(1, 4096);
///     }
/// }
/// assert_eq!(Network::default().hidden, 256);
/// ```
#[macro_export]
macro_rules! settings {
    (
        $(#[doc = $about:literal])+
        $(#[derive($extra:ident)])?
        $visible:vis struct $name:ident {
            $($(#[doc = $doc:literal])+ $seen:vis $field:ident: $type:ty = $default:expr, $shape:expr;)*
        }
    ) => {
        $(#[doc = $about])+
        #[derive(Debug, Clone, PartialEq, $($extra)?)]
        $visible struct $name {
            $($(#[doc = $doc])+ $seen $field: $type,)*
        }

        impl ::core::default::Default for $name {
            fn default() -> Self {
                Self { $($field: $default),* }
            }
        }

        impl $crate::private::Serialize for $name {
            fn serialize<S: $crate::private::Serializer>(
                &self,
                serializer: S,
            ) -> ::core::result::Result<S::Ok, S::Error> {
                let mut values = $crate::Values::new();
                $crate::Group::write(self, &mut values);
                $crate::private::Serialize::serialize(&values, serializer)
            }
        }

        impl<'de> $crate::private::Deserialize<'de> for $name {
            fn deserialize<D: $crate::private::Deserializer<'de>>(
                deserializer: D,
            ) -> ::core::result::Result<Self, D::Error> {
                let values = <$crate::Values as $crate::private::Deserialize>::deserialize(deserializer)?;
                <Self as $crate::Group>::read(&values).map_err($crate::private::Error::custom)
            }
        }

        impl $crate::Group for $name {
            fn schema() -> ::std::vec::Vec<$crate::Setting> {
                ::std::vec![$($crate::Setting {
                    name: ::core::stringify!($field).to_owned(),
                    about: $crate::private::text(&[$($doc),+]),
                    shape: $shape,
                    default: $crate::private::json(&<Self as ::core::default::Default>::default().$field),
                }),*]
            }

            fn read(values: &$crate::Values) -> ::core::result::Result<Self, $crate::Problem> {
                let mut schema = <Self as $crate::Group>::schema().into_iter();
                ::core::result::Result::Ok(Self {
                    $($field: match schema.next() {
                        ::core::option::Option::Some(setting) => $crate::private::take(values, &setting)?,
                        ::core::option::Option::None => $default,
                    },)*
                })
            }

            fn write(&self, values: &mut $crate::Values) {
                $(values.insert(
                    ::core::stringify!($field).to_owned(),
                    $crate::private::json(&self.$field),
                );)*
            }
        }
    };
}

/// Defines an enum whose values are words. The first value is the default. The crate that uses it depends on `serde`.
#[macro_export]
macro_rules! words {
    (
        $(#[doc = $about:literal])+
        $visible:vis enum $name:ident { $(#[doc = $first_doc:literal])+ $first:ident = $first_word:literal,
            $($(#[doc = $doc:literal])+ $value:ident = $word:literal),* $(,)? }
    ) => {
        $(#[doc = $about])+
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
        $visible enum $name {
            $(#[doc = $first_doc])+
            #[default]
            #[serde(rename = $first_word)]
            $first,
            $($(#[doc = $doc])+ #[serde(rename = $word)] $value,)*
        }

        impl ::core::str::FromStr for $name {
            type Err = ::std::string::String;

            fn from_str(text: &str) -> ::core::result::Result<Self, Self::Err> {
                let mut all = <Self as $crate::Words>::ALL.iter().map(|word| word.value);
                all.find(|value| $crate::Words::as_str(*value) == text).ok_or_else(|| {
                    let words: ::std::vec::Vec<&str> =
                        <Self as $crate::Words>::ALL.iter().map(|word| $crate::Words::as_str(word.value)).collect();
                    ::std::format!("unknown value {text:?}; supported: {}", words.join(", "))
                })
            }
        }

        impl $crate::Words for $name {
            const ALL: &'static [$crate::Word<Self>] = &[
                $crate::Word { value: Self::$first, about: concat!($($first_doc),+) },
                $($crate::Word { value: Self::$value, about: concat!($($doc),+) },)*
            ];

            fn as_str(self) -> &'static str {
                match self {
                    Self::$first => $first_word,
                    $(Self::$value => $word,)*
                }
            }
        }
    };
}
