#include "core/records/source_digest.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <string_view>

#include "core/base/files.hpp"
#include "core/base/sha256.hpp"

namespace gpuphys {
namespace {

namespace fs = std::filesystem;

bool is_identifier_char(char c) {
  return std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '_';
}
bool is_blank(char c) {
  return c == ' ' || c == '\t' || c == '\r' || c == '\f' || c == '\v';
}

// One token of a source, with the line it starts on.
struct Token {
  enum class Kind { word, punctuation, literal, newline } kind;
  std::string text;
  bool space_before = false;
  int line = 0;
};

// Operators of more than one character, longest first. White space inside them matters ("a+ ++b" is not "a++
// +b"); '>' is left alone, so that "> >" and ">>" at the end of template arguments are the same.
constexpr std::string_view kOperators[] = {"<<=", "<=>", "->*", "...", "::", "->", "++", "--", "<<",
                                           "<=",  ">=",  "==",  "!=",  "&&", "||", "+=", "-=", "*=",
                                           "/=",  "%=",  "&=",  "|=",  "^=", "##", ".*"};

// The first phases of translation: splices continued lines, drops comments, finds the extent of literals, and
// keeps line ends, which matter for directives. Numbers and identifiers come out as words (a number may hold
// "1.5e+3", whose sign is part of the word), operators whole.
class Tokenizer {
 public:
  Tokenizer(const std::string& text, std::string where) : text_(text), where_(std::move(where)) {}

  std::vector<Token> run() {
    std::vector<Token> tokens;
    bool space = false;
    const auto add = [&](Token::Kind kind, std::string content, int line) {
      tokens.push_back({kind, std::move(content), space, line});
      space = false;
    };
    for (;;) {
      splice();
      if (at_end()) break;
      const char c = text_[i_];
      const int line = line_;
      if (c == '\n') {
        ++i_;
        ++line_;
        add(Token::Kind::newline, "\n", line);
      } else if (is_blank(c)) {
        ++i_;
        space = true;
      } else if (c == '/' && peek() == '/') {
        line_comment();
        space = true;
      } else if (c == '/' && peek() == '*') {
        block_comment();
        space = true;
      } else if (c == '"') {
        add(Token::Kind::literal, quoted('"'), line);
      } else if (c == '\'') {
        add(Token::Kind::literal, quoted('\''), line);
      } else if (is_identifier_char(c) || (c == '.' && std::isdigit(static_cast<unsigned char>(peek())))) {
        std::string content = word();
        if (!at_end() && text_[i_] == '"' && is_raw_prefix(content)) {
          content += raw_string();
          add(Token::Kind::literal, std::move(content), line);
        } else {
          add(Token::Kind::word, std::move(content), line);
        }
      } else {
        add(Token::Kind::punctuation, punctuation(), line);
      }
    }
    return tokens;
  }

 private:
  bool at_end() const { return i_ >= text_.size(); }

  // Length of a backslash and line end at `at`, 0 when there is none.
  std::size_t continuation(std::size_t at) const {
    if (at >= text_.size() || text_[at] != '\\') return 0;
    std::size_t end = at + 1;
    while (end < text_.size() && is_blank(text_[end]))
      ++end;  // as compilers do, blanks after the backslash are forgiven
    return end < text_.size() && text_[end] == '\n' ? end + 1 - at : 0;
  }

  void splice() {
    while (const std::size_t n = continuation(i_)) {
      i_ += n;
      ++line_;
    }
  }

  // The character after the present one, behind any continuation.
  char peek() const {
    std::size_t at = i_ + 1;
    while (const std::size_t n = continuation(at)) at += n;
    return at < text_.size() ? text_[at] : '\0';
  }

  // Takes the present character and moves past continuations behind it.
  char take() {
    const char c = text_[i_++];
    if (c == '\n') ++line_;
    splice();
    return c;
  }

  void line_comment() {
    while (!at_end() && text_[i_] != '\n') take();
  }

  void block_comment() {
    const int start = line_;
    take();
    take();
    while (!at_end()) {
      if (take() == '*' && !at_end() && text_[i_] == '/') {
        ++i_;
        return;
      }
    }
    fail(start, "comment does not end");
  }

  // A quote without a partner ends with the line: compilers accept that in "#error don't" and in disabled
  // groups.
  std::string quoted(char quote) {
    std::string content(1, take());
    while (!at_end() && text_[i_] != '\n') {
      const char c = take();
      content += c;
      if (c == quote) break;
      if (c == '\\' && !at_end() && text_[i_] != '\n') content += take();
    }
    return content;
  }

  std::string punctuation() {
    for (const std::string_view op : kOperators) {
      if (std::string_view(text_).substr(i_, op.size()) == op) {
        i_ += op.size();
        return std::string(op);
      }
    }
    return std::string(1, text_[i_++]);
  }

  // An identifier or a number. A quote between digits separates them, it does not start a literal.
  std::string word() {
    std::string content(1, take());
    const bool number = std::isdigit(static_cast<unsigned char>(content[0])) || content[0] == '.';
    while (!at_end()) {
      const char c = text_[i_];
      const bool exponent_sign = number && (c == '+' || c == '-') && is_exponent(content);
      const bool separator = number && c == '\'' && is_identifier_char(peek());
      if (!is_identifier_char(c) && !(number && c == '.') && !exponent_sign && !separator) break;
      content += take();
    }
    return content;
  }

  static bool is_exponent(const std::string& number) {
    const bool hex = number.size() > 1 && (number[1] == 'x' || number[1] == 'X');
    const char last = number.back();
    return hex ? last == 'p' || last == 'P' : last == 'e' || last == 'E';
  }

  static bool is_raw_prefix(const std::string& prefix) {
    return prefix == "R" || prefix == "u8R" || prefix == "uR" || prefix == "UR" || prefix == "LR";
  }

  // From the opening quote on, character by character: nothing is spliced or interpreted inside a raw string.
  std::string raw_string() {
    const int start = line_;
    const std::size_t open = text_.find('(', i_);
    if (open == std::string::npos) fail(start, "raw string literal does not end");
    const std::string end = ")" + text_.substr(i_ + 1, open - i_ - 1) + "\"";
    const std::size_t close = text_.find(end, open);
    if (close == std::string::npos) fail(start, "raw string literal does not end");
    std::string content = text_.substr(i_, close + end.size() - i_);
    line_ += static_cast<int>(std::count(content.begin(), content.end(), '\n'));
    i_ = close + end.size();
    return content;
  }

  [[noreturn]] void fail(int line, const std::string& what) const {
    throw Error(ExitCode::bad_input, fmt::format("{}:{}: {}", where_, line, what));
  }

  const std::string& text_;
  std::string where_;
  std::size_t i_ = 0;
  int line_ = 1;
};

struct Include {
  std::string path;
  int line;
};

std::vector<Include> includes_of(const std::vector<Token>& tokens) {
  std::vector<Include> found;
  bool line_start = true;
  for (std::size_t i = 0; i < tokens.size(); ++i) {
    if (line_start && tokens[i].text == "#" && i + 2 < tokens.size() && tokens[i + 1].text == "include" &&
        tokens[i + 2].kind == Token::Kind::literal && tokens[i + 2].text.front() == '"') {
      const std::string& quoted = tokens[i + 2].text;
      found.push_back({quoted.substr(1, quoted.size() - 2), tokens[i].line});
    }
    line_start = tokens[i].kind == Token::Kind::newline;
  }
  return found;
}

bool is_source(const std::string& path) {
  static const std::set<std::string> extensions = {".h", ".hpp", ".cuh", ".c", ".cpp", ".cu"};
  return extensions.contains(fs::path(path).extension().string());
}

bool is_header(const std::string& path) {
  static const std::set<std::string> extensions = {".h", ".hpp", ".cuh"};
  return extensions.contains(fs::path(path).extension().string());
}

// Where a source lies: a mutant's patched copies come first, as on its include path.
fs::path located(const Roots& roots, const std::string& file) {
  if (!roots.overlay.empty() && fs::is_regular_file(fs::path(roots.overlay) / file))
    return fs::path(roots.overlay) / file;
  return fs::path(roots.source) / file;
}

void visit(const Roots& root, const std::string& file, std::set<std::string>& seen) {
  if (!seen.insert(file).second || !is_source(file)) return;
  const bool elsewhere = root.of_module && (file.starts_with("cases/") || file.starts_with("core/"));
  if (is_header(file) && !elsewhere) {
    for (const char* extension : {".cpp", ".cu", ".c"}) {
      const std::string implementation = fs::path(file).replace_extension(extension).generic_string();
      if (fs::exists(located(root, implementation))) visit(root, implementation, seen);
    }
  }
  const std::string text = read_file(located(root, file).string());
  for (const Include& include : includes_of(Tokenizer(text, file).run())) {
    const std::string path = fs::path(include.path).lexically_normal().generic_string();
    if (path.starts_with("..") || path.starts_with("/") || !fs::is_regular_file(located(root, path))) {
      throw Error(
          ExitCode::bad_input,
          fmt::format(
              "{}:{}: includes \"{}\", which does not exist (quoted includes start at the repository root)",
              file, include.line, include.path));
    }
    visit(root, path, seen);
  }
}

}  // namespace

std::string stripped_source(const std::string& text, const std::string& where) {
  using Kind = Token::Kind;
  std::string out;
  const Token* last = nullptr;  // on the present line of output
  bool directive = false, line_start = true;
  std::vector<std::string> directive_words;
  const std::vector<Token> tokens = Tokenizer(text, where).run();
  for (const Token& t : tokens) {
    if (t.kind == Kind::newline) {
      // Only the end of a directive means something; every other line end is white space.
      if (directive) {
        out += '\n';
        last = nullptr;
      }
      directive = false;
      line_start = true;
      continue;
    }
    if (line_start && t.text == "#") {
      if (last != nullptr) out += '\n';
      last = nullptr;
      directive = true;
      directive_words.clear();
    }
    // Tokens are joined by one blank whatever lay between them, except where touching means something: a
    // literal with its prefix or suffix, and the parameter list of a macro ("#define f(x)" is not "#define f
    // (x)").
    const bool touches = last != nullptr && !t.space_before && !line_start;
    const bool with_literal =
        last != nullptr && last->kind != Kind::punctuation && t.kind != Kind::punctuation;
    const bool parameters =
        directive && t.text == "(" && directive_words.size() == 3 && directive_words[1] == "define";
    if (last != nullptr && !(touches && (with_literal || parameters))) out += ' ';
    out += t.text;
    if (directive) directive_words.push_back(t.text);
    last = &t;
    line_start = false;
  }
  if (!out.empty() && out.back() != '\n') out += '\n';
  return out;
}

std::vector<std::string> quoted_includes(const std::string& text, const std::string& where) {
  std::vector<std::string> paths;
  for (const Include& include : includes_of(Tokenizer(text, where).run())) paths.push_back(include.path);
  return paths;
}

std::set<std::string> source_dependencies(const Roots& where, const std::vector<std::string>& roots) {
  std::set<std::string> seen;
  for (const std::string& root : roots) {
    if (!fs::is_regular_file(located(where, root))) {
      throw Error(ExitCode::bad_input,
                  fmt::format("source '{}' does not exist below '{}'", root, where.source));
    }
    visit(where, fs::path(root).lexically_normal().generic_string(), seen);
  }
  return seen;
}

SourceDigest digest_sources(const Roots& where, const std::vector<std::string>& roots) {
  SourceDigest digest;
  Sha256 total;
  for (const std::string& file : source_dependencies(where, roots)) {
    const std::string text = read_file(located(where, file).string());
    const std::string sum = sha256_hex(is_source(file) ? stripped_source(text, file) : text);
    digest.files[file] = sum;
    total.add(file);
    total.add(sum);
  }
  digest.total = total.hex();
  return digest;
}

std::vector<std::string> digest_differences(const SourceDigest& recorded, const SourceDigest& now) {
  std::vector<std::string> lines;
  for (const auto& [file, sum] : now.files) {
    const auto it = recorded.files.find(file);
    if (it == recorded.files.end()) {
      lines.push_back("added: " + file);
    } else if (it->second != sum) {
      lines.push_back("changed: " + file);
    }
  }
  for (const auto& [file, sum] : recorded.files) {
    if (!now.files.contains(file)) lines.push_back("removed: " + file);
  }
  return lines;
}

}  // namespace gpuphys
