//! What a Rust file says about other files: its modules, what it imports, the paths in its code.
//! Tests are left out.

use proc_macro2::{Delimiter, Spacing, TokenStream, TokenTree};

use crate::sources::Source;

/// A path as it stands in the code.
pub struct Path {
    /// Where, from 1.
    pub line: usize,
    /// The modules within the file that it stands in, outermost first.
    pub inside: Vec<String>,
    /// What stands between the `::`, for example `crate`, `image`, `Image`.
    pub segments: Vec<String>,
}

/// One name that a `use` brings in.
pub struct Import {
    /// What the file calls it.
    pub name: String,
    /// What it is.
    pub path: Path,
    /// Whether `pub`, with or without a limit, stands before the `use`.
    pub exported: bool,
}

/// What of a file concerns other files.
#[derive(Default)]
pub struct Outline {
    /// Every `mod child;`, behind the modules within the file that it stands in.
    pub children: Vec<Vec<String>>,
    /// Everything that is imported.
    pub imports: Vec<Import>,
    /// Every other path. Of those without `::` only types, constants and calls: any other name
    /// may as well be a variable.
    pub paths: Vec<Path>,
}

impl Outline {
    /// Reads a file.
    ///
    /// # Panics
    /// Where the file is no Rust.
    pub fn of(source: &Source) -> Self {
        let tokens: TokenStream = source
            .text
            .parse()
            .unwrap_or_else(|error| panic!("{}: {error}", source.path));
        let mut outline = Self::default();
        outline.read(tokens, &[]);
        outline
    }

    fn read(&mut self, tokens: TokenStream, inside: &[String]) {
        let tokens: Vec<TokenTree> = tokens.into_iter().collect();
        let mut at = 0;
        while at < tokens.len() {
            at += match word(&tokens[at]).as_deref() {
                Some("use") if !is(tokens.get(at + 1), '<') => {
                    let (exported, rest) = (is_exported(&tokens[..at]), &tokens[at + 1..]);
                    let length = until_semicolon(rest);
                    self.import(&rest[..length], &[], inside, exported);
                    1 + length
                }
                Some("mod") => self.module(&tokens[at..], inside),
                Some("fn") => 2,
                Some(_) => self.path(&tokens[at..], inside),
                None => self.other(&tokens[at..], inside),
            };
        }
    }

    /// Reads `mod name;` or `mod name { .. }` and says how many tokens that are.
    fn module(&mut self, tokens: &[TokenTree], inside: &[String]) -> usize {
        let mut modules = inside.to_vec();
        modules.extend(tokens.get(1).and_then(word));
        match tokens.get(2) {
            Some(TokenTree::Group(body)) => self.read(body.stream(), &modules),
            _ => self.children.push(modules),
        }
        3
    }

    /// Reads what follows `use`, or what stands in one of its braces.
    fn import(
        &mut self,
        tokens: &[TokenTree],
        prefix: &[String],
        inside: &[String],
        exported: bool,
    ) {
        for tree in tokens.split(|token| is(Some(token), ',')) {
            let (mut segments, mut alias, mut line) = (prefix.to_vec(), None, 0);
            for (at, token) in tree.iter().enumerate() {
                line = token.span().start().line;
                match (word(token), token) {
                    (Some(word), _) if word == "as" => {
                        alias = tree.get(at + 1).and_then(self::word);
                    }
                    (Some(word), _) if alias.is_none() => segments.push(word),
                    (_, TokenTree::Group(braces)) => {
                        let inner: Vec<TokenTree> = braces.stream().into_iter().collect();
                        self.import(&inner, &segments, inside, exported);
                        segments.clear();
                    }
                    _ if is(Some(token), '*') => segments.push("*".to_owned()),
                    _ => {}
                }
            }
            if segments.len() > 1 && segments.last().is_some_and(|last| last == "self") {
                segments.pop();
            }
            if let Some(last) = segments.last() {
                let name = alias.unwrap_or_else(|| last.clone());
                let path = Path {
                    line,
                    inside: inside.to_vec(),
                    segments,
                };
                self.imports.push(Import {
                    name,
                    path,
                    exported,
                });
            }
        }
    }

    /// Reads a path and says how many tokens it is.
    fn path(&mut self, tokens: &[TokenTree], inside: &[String]) -> usize {
        let mut segments: Vec<String> = word(&tokens[0]).into_iter().collect();
        let mut length = 1;
        while let [colon, second, next, ..] = &tokens[length..]
            && is_joint_colon(colon)
            && is(Some(second), ':')
            && let Some(segment) = word(next)
        {
            segments.push(segment);
            length += 3;
        }
        let upper = segments[0].starts_with(|c: char| c.is_ascii_uppercase());
        if segments.len() > 1 || upper || is_arguments(tokens.get(length)) {
            let line = tokens[0].span().start().line;
            self.paths.push(Path {
                line,
                inside: inside.to_vec(),
                segments,
            });
        }
        length
    }

    /// Reads what is neither a word nor begins with one, and says how many tokens that are.
    fn other(&mut self, tokens: &[TokenTree], inside: &[String]) -> usize {
        if is(tokens.first(), '#') && tokens.get(1).is_some_and(is_for_tests) {
            return 2 + item_length(&tokens[2..]);
        }
        if let TokenTree::Group(group) = &tokens[0] {
            self.read(group.stream(), inside);
        }
        // Behind a dot stands a field or a method; behind two dots, the end of a range.
        let dot = is(tokens.first(), '.');
        let named = dot || is(tokens.first(), '\'');
        match tokens.get(1) {
            Some(TokenTree::Ident(_)) if named => 2,
            next if dot && is(next, '.') => 2,
            _ => 1,
        }
    }
}

/// How many tokens the item at the beginning is, with its attributes.
fn item_length(tokens: &[TokenTree]) -> usize {
    let ends = |token: &TokenTree| match token {
        TokenTree::Group(group) => group.delimiter() == Delimiter::Brace,
        _ => is(Some(token), ';'),
    };
    let end = tokens.iter().position(ends);
    end.map_or(tokens.len(), |end| end + 1)
}

fn until_semicolon(tokens: &[TokenTree]) -> usize {
    let end = tokens.iter().position(|token| is(Some(token), ';'));
    end.unwrap_or(tokens.len())
}

/// Whether `[cfg(..)]` leaves an item to tests alone.
fn is_for_tests(attribute: &TokenTree) -> bool {
    let TokenTree::Group(attribute) = attribute else {
        return false;
    };
    let text = attribute.stream().to_string().replace(' ', "");
    text == "cfg(test)" || text.starts_with("cfg(all(test,")
}

/// Whether `pub` or `pub(..)` ends the tokens.
fn is_exported(before: &[TokenTree]) -> bool {
    let limit = matches!(before.last(), Some(TokenTree::Group(_)));
    let before = &before[..before.len() - usize::from(limit)];
    before
        .last()
        .and_then(word)
        .is_some_and(|word| word == "pub")
}

fn word(token: &TokenTree) -> Option<String> {
    match token {
        TokenTree::Ident(word) => Some(word.to_string()),
        _ => None,
    }
}

fn is(token: Option<&TokenTree>, sign: char) -> bool {
    matches!(token, Some(TokenTree::Punct(punct)) if punct.as_char() == sign)
}

fn is_joint_colon(token: &TokenTree) -> bool {
    matches!(token, TokenTree::Punct(colon)
        if colon.as_char() == ':' && colon.spacing() == Spacing::Joint)
}

fn is_arguments(token: Option<&TokenTree>) -> bool {
    matches!(token, Some(TokenTree::Group(group))
        if group.delimiter() == Delimiter::Parenthesis)
}

/// Every path of the code, in order.
fn paths(text: &str) -> Vec<String> {
    let outline = Outline::of(&Source::made_up("a.rs", text));
    let joined = |path: &Path| format!("{}:{}", path.line, path.segments.join("::"));
    outline.paths.iter().map(joined).collect()
}

#[test]
fn an_import_is_read_name_by_name() {
    let text = "use a::{b, c::{self, D as E}};\npub(super) use f::*;\nmod g;\nmod h { mod i; }\n";
    let outline = Outline::of(&Source::made_up("a.rs", text));
    let imports = outline.imports.iter().map(|import| {
        let (path, exported) = (import.path.segments.join("::"), import.exported);
        format!("{}:{path} {} {exported}", import.path.line, import.name)
    });
    assert_eq!(
        imports.collect::<Vec<_>>(),
        [
            "1:a::b b false",
            "1:a::c c false",
            "1:a::c::D E false",
            "2:f::* * true"
        ]
    );
    assert_eq!(outline.children, [vec!["g"], vec!["h", "i"]]);
}

#[test]
fn paths_are_read_outside_of_comments_strings_fields_and_tests() {
    let text = "// a::b()\nfn c() { let d = e::f(\"g::h\"); d.i(); j(0..super::k); }\n\
                #[cfg(test)]\nmod tests { l::m(); }\n#[cfg(test)]\nuse n::o;\n#[p(q::r)]\nstruct S;\n";
    assert_eq!(
        paths(text),
        ["2:e::f", "2:j", "2:super::k", "7:p", "7:q::r", "8:S"]
    );
}
