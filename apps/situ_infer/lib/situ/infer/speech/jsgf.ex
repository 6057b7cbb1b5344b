defmodule Situ.Infer.Speech.Jsgf do
  @moduledoc false
  # Parses grammars in the Java Speech Grammar Format (JSGF 1.0, <https://www.w3.org/TR/jsgf/>):
  # rules, alternatives, `[optional]`, `(groups)`, `*`, `+`, `"quoted words"`, weights, tags,
  # comments, `<NULL>` and `<VOID>`.
  #
  # Situ adds two built-in rules: `<NUMBER>` matches a number from 0 to 999 in words or digits,
  # and `<WORDS>` matches one or more words of any kind. `import` is not supported; a grammar must
  # be a single text.
  alias Situ.Error

  @most_bytes 1_000_000
  @deepest 200
  @built_in ~w(NULL VOID NUMBER WORDS)

  @enforce_keys [:name, :public, :rules]
  defstruct [:name, :public, :rules]

  @type expansion ::
          {:word, String.t()}
          | {:rule, String.t()}
          | {:seq | :alt, [expansion()]}
          | {:optional | :many | :some, expansion()}
          | {:tag, expansion(), String.t()}
  @type t :: %__MODULE__{
          name: String.t(),
          public: [String.t()],
          rules: %{String.t() => expansion()}
        }

  @doc "Returns the text of a grammar, given as text or as the path of its file."
  @spec read_text(String.t() | Path.t()) :: {:ok, String.t()} | {:error, Error.t()}
  def read_text(text_or_path) do
    if String.contains?(text_or_path, ["#JSGF", "\n", ";"]) do
      {:ok, text_or_path}
    else
      with {:error, why} <- File.read(text_or_path) do
        what = "cannot read the grammar: #{:file.format_error(why)}"
        {:error, Error.new(:no_grammar, what, fix: "check the path #{text_or_path}")}
      end
    end
  end

  @doc """
  Parses the text of a grammar; errors report the line.

      iex> {:ok, grammar} = Situ.Infer.Speech.Jsgf.parse("#JSGF V1.0; grammar g; public <yes> = yes | of course;")
      iex> grammar.rules["yes"]
      {:alt, [{:word, "yes"}, {:seq, [{:word, "of"}, {:word, "course"}]}]}
  """
  @spec parse(String.t()) :: {:ok, t()} | {:error, Error.t()}
  def parse(text) do
    with :ok <- check_text(text),
         {:ok, tokens} <- tokenize(text, 1, []),
         {:ok, name, tokens} <- parse_header(tokens),
         {:ok, grammar} <- parse_rules(tokens, %__MODULE__{name: name, public: [], rules: %{}}),
         :ok <- check_rules(grammar) do
      {:ok, %{grammar | public: Enum.reverse(grammar.public)}}
    else
      {:error, %Error{}} = error -> error
      {:error, line, what} -> {:error, bad_grammar("line #{line}: #{what}")}
    end
  end

  defp bad_grammar(why) do
    Error.new(:bad_grammar, "invalid grammar",
      why: why,
      fix: "see https://www.w3.org/TR/jsgf/"
    )
  end

  defp check_text(text) do
    cond do
      not String.valid?(text) ->
        {:error, bad_grammar("it is not valid UTF-8 text")}

      byte_size(text) > @most_bytes ->
        {:error, bad_grammar("it has more than #{@most_bytes} bytes")}

      true ->
        :ok
    end
  end

  # Tokens have the form {kind, line} or {kind, line, text}.
  defp tokenize("", line, tokens), do: {:ok, Enum.reverse([{:end, line} | tokens])}
  defp tokenize("\n" <> rest, line, tokens), do: tokenize(rest, line + 1, tokens)

  defp tokenize(<<c, rest::binary>>, line, tokens) when c in ~c" \t\r",
    do: tokenize(rest, line, tokens)

  defp tokenize("\uFEFF" <> rest, line, tokens), do: tokenize(rest, line, tokens)

  defp tokenize("//" <> rest, line, tokens) do
    case String.split(rest, "\n", parts: 2) do
      [_, rest] -> tokenize("\n" <> rest, line, tokens)
      [_] -> tokenize("", line, tokens)
    end
  end

  defp tokenize("/*" <> rest, line, tokens) do
    case String.split(rest, "*/", parts: 2) do
      [comment, rest] -> tokenize(rest, line + count_newlines(comment), tokens)
      [_] -> {:error, line, "a comment is not closed"}
    end
  end

  defp tokenize("{" <> rest, line, tokens) do
    case Regex.run(~r/\A((?:[^\\}]|\\.)*)\}/s, rest) do
      [all, tag] ->
        text = tag |> String.replace(~r/\\(.)/s, "\\1") |> String.trim()

        tokenize(drop_prefix(rest, all), line + count_newlines(all), [{:tag, line, text} | tokens])

      nil ->
        {:error, line, "a tag is not closed"}
    end
  end

  defp tokenize("\"" <> rest, line, tokens) do
    case Regex.run(~r/\A((?:[^\\"]|\\.)*)"/s, rest) do
      [all, words] ->
        words = words |> String.replace(~r/\\(.)/s, "\\1") |> String.split()
        quoted = Enum.map(words, &{:word, line, &1})
        tokenize(drop_prefix(rest, all), line + count_newlines(all), Enum.reverse(quoted, tokens))

      nil ->
        {:error, line, "a quotation is not closed"}
    end
  end

  defp tokenize("<" <> rest, line, tokens) do
    case Regex.run(~r/\A([^<>\s;=|()\[\]{}]+)>/u, rest) do
      [all, name] -> tokenize(drop_prefix(rest, all), line, [{:rule, line, name} | tokens])
      nil -> {:error, line, "the name of a rule is not closed with `>`"}
    end
  end

  defp tokenize("/" <> rest, line, tokens) do
    case Regex.run(~r/\A\s*[0-9.]+\s*\//, rest) do
      [all] -> tokenize(drop_prefix(rest, all), line, tokens)
      nil -> {:error, line, "a weight must have the form /0.5/"}
    end
  end

  defp tokenize(<<c, rest::binary>>, line, tokens) when c in ~c";=|()[]*+",
    do: tokenize(rest, line, [{sign(c), line} | tokens])

  defp tokenize(text, line, tokens) do
    [word] = Regex.run(~r/\A(?:[^\s;=|()\[\]{}<>*+\/"]|\/(?![\/*]))+|\A./u, text)
    tokenize(drop_prefix(text, word), line, [{:word, line, word} | tokens])
  end

  for c <- ~c";=|()[]*+", do: defp(sign(unquote(c)), do: unquote(List.to_atom([c])))

  defp drop_prefix(text, part),
    do: binary_part(text, byte_size(part), byte_size(text) - byte_size(part))

  defp count_newlines(text), do: text |> :binary.matches("\n") |> length()

  defp parse_header([{:word, _, "#JSGF"}, {:word, _, "V1.0"} | rest]) do
    case Enum.drop_while(rest, &match?({:word, _, _}, &1)) do
      [{:";", _}, {:word, _, "grammar"}, {:word, _, name}, {:";", _} | rest] -> {:ok, name, rest}
      [{_, line} | _] -> {:error, line, "`grammar NAME;` must follow"}
      [{_, line, _} | _] -> {:error, line, "`grammar NAME;` must follow"}
    end
  end

  defp parse_header(_), do: {:error, 1, "the text does not begin with `#JSGF V1.0;`"}

  defp parse_rules([{:end, _}], grammar), do: {:ok, grammar}

  defp parse_rules([{:word, _, "public"}, {:rule, line, name} | rest], grammar),
    do: parse_rule(name, line, rest, %{grammar | public: [name | grammar.public]})

  defp parse_rules([{:rule, line, name} | rest], grammar),
    do: parse_rule(name, line, rest, grammar)

  defp parse_rules([{:word, line, "import"} | _], _grammar),
    do: {:error, line, "import is not supported; write all rules in one text"}

  defp parse_rules([token | _], _grammar),
    do: {:error, elem(token, 1), "expected `<name> = ...;`"}

  defp parse_rule(name, line, [{:=, _} | rest], grammar) do
    cond do
      name in @built_in -> {:error, line, "<#{name}> is a built-in rule"}
      is_map_key(grammar.rules, name) -> {:error, line, "<#{name}> is defined twice"}
      true -> parse_body(name, rest, grammar)
    end
  end

  defp parse_rule(name, line, _rest, _grammar), do: {:error, line, "`=` must follow <#{name}>"}

  defp parse_body(name, tokens, grammar) do
    with {:ok, expansion, rest} <- parse_alternatives(tokens, 0) do
      case rest do
        [{:";", _} | rest] -> parse_rules(rest, put_in(grammar.rules[name], expansion))
        [token | _] -> {:error, elem(token, 1), "<#{name}> does not end with `;`"}
      end
    end
  end

  defp parse_alternatives([token | _], depth) when depth > @deepest,
    do: {:error, elem(token, 1), "groups are nested more than #{@deepest} deep"}

  defp parse_alternatives(tokens, depth) do
    with {:ok, first, rest} <- parse_sequence(tokens, [], depth) do
      case rest do
        [{:|, _} | rest] ->
          with {:ok, other, rest} <- parse_alternatives(rest, depth),
               do: {:ok, add_alternative(first, other), rest}

        rest ->
          {:ok, first, rest}
      end
    end
  end

  defp add_alternative(first, {:alt, others}), do: {:alt, [first | others]}
  defp add_alternative(first, other), do: {:alt, [first, other]}

  defp parse_sequence([{:word, _, word} | rest], items, depth) do
    words = for word <- Situ.Infer.Speech.Utterance.normalize_words(word), do: {:word, word}
    parse_sequence(rest, Enum.reverse(words, items), depth)
  end

  defp parse_sequence([{:rule, _, name} | rest], items, depth),
    do: parse_sequence(rest, [{:rule, name} | items], depth)

  defp parse_sequence([{:"(", line} | rest], items, depth),
    do: parse_group(rest, :")", line, items, depth, & &1)

  defp parse_sequence([{:"[", line} | rest], items, depth),
    do: parse_group(rest, :"]", line, items, depth, &{:optional, &1})

  defp parse_sequence([{sign, line} | rest], items, depth) when sign in [:*, :+] do
    case items do
      [last | items] ->
        parse_sequence(rest, [{if(sign == :*, do: :many, else: :some), last} | items], depth)

      [] ->
        {:error, line, "`#{sign}` has no preceding item"}
    end
  end

  defp parse_sequence([{:tag, line, text} | rest], items, depth) do
    case items do
      [last | items] -> parse_sequence(rest, [{:tag, last, text} | items], depth)
      [] -> {:error, line, "{#{text}} has no preceding item"}
    end
  end

  defp parse_sequence([token | _], [], _depth),
    do: {:error, elem(token, 1), "an alternative is empty"}

  defp parse_sequence(rest, [one], _depth), do: {:ok, one, rest}
  defp parse_sequence(rest, items, _depth), do: {:ok, {:seq, Enum.reverse(items)}, rest}

  defp parse_group(tokens, close, line, items, depth, wrap) do
    with {:ok, inner, rest} <- parse_alternatives(tokens, depth + 1) do
      case rest do
        [{^close, _} | rest] -> parse_sequence(rest, [wrap.(inner) | items], depth)
        _ -> {:error, line, "a group is not closed"}
      end
    end
  end

  defp check_rules(%{public: []}), do: {:error, bad_grammar("no rule is public")}

  defp check_rules(grammar) do
    known = Map.keys(grammar.rules) ++ @built_in
    used = grammar.rules |> Map.values() |> Enum.flat_map(&used_rules/1)

    require_known(Enum.find(used, &(&1 not in known)), known)
  end

  defp require_known(nil, _known), do: :ok

  defp require_known(name, known) do
    near = Situ.Options.nearest_name(name, known)
    {:error, bad_grammar("unknown rule <#{name}>#{if near, do: "; did you mean <#{near}>?"}")}
  end

  defp used_rules({:rule, name}), do: [name]

  defp used_rules({kind, parts}) when kind in [:seq, :alt],
    do: Enum.flat_map(parts, &used_rules/1)

  defp used_rules({:word, _}), do: []
  defp used_rules({:tag, part, _}), do: used_rules(part)
  defp used_rules({_, part}), do: used_rules(part)
end
