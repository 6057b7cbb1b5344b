defmodule Situ.Intent.Grammar do
  @moduledoc """
  Detects intents with rules: a grammar in the Java Speech Grammar Format (JSGF 1.0, <https://www.w3.org/TR/jsgf/>) with
  tags.

      #JSGF V1.0; grammar room;
      public <time>  = what time is it {intent=time} | tell me the time {intent=time};
      public <light> = turn {intent=light} (on {state=on} | off {state=off}) the light [in the <room> {room}];
      <room> = kitchen | bed room;

  `{intent=NAME}` sets the intent, and `{KEY=VALUE}` adds an entity. `{KEY}` adds an entity whose value is the matched
  text, or the number matched by `<NUMBER>`. The intent of a rule without `{intent=...}` is the rule's name. The score
  is the share of the sentence's words that the rule matches; the rule that matches most words comes first.

  Two rules are built in: `<NUMBER>` matches a number from 0 to 999 in words or digits, and `<WORDS>` matches one or
  more words of any kind. `import` is not supported.

  ## Errors

  `:bad_grammar` (with the line), `:no_grammar` (the file cannot be read).
  """

  @schema [
    grammar: [
      type: :string,
      required: true,
      doc: "The grammar as text, or the path of its file."
    ],
    where: [
      type: {:in, [:anywhere, :whole]},
      default: :anywhere,
      doc: "Whether the grammar may match a part of the sentence, or must match all of it."
    ],
    min_score: [
      type: {:range, 0.0, 1.0},
      default: 0.0,
      doc: "The minimum share of the sentence's words that the grammar must match."
    ]
  ]

  Situ.Options.add_to_moduledoc(__MODULE__, @schema)

  @behaviour Situ.Intent.Recognizer

  alias Situ.{Error, Intent}
  alias Situ.Infer.Speech.{Jsgf, Utterance}
  alias Situ.Infer.Speech.Jsgf.Matcher

  # No spoken sentence is longer.
  @most_words 200

  @enforce_keys [:jsgf, :where, :min_score]
  defstruct [:jsgf, :where, :min_score]
  @type t :: %__MODULE__{jsgf: Jsgf.t(), where: :anywhere | :whole, min_score: float()}

  @impl true
  @spec load(keyword()) :: {:ok, t()} | {:error, Error.t()}
  def load(opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, text} <- Jsgf.read_text(opts[:grammar]),
         {:ok, jsgf} <- Jsgf.parse(text),
         do: {:ok, %__MODULE__{jsgf: jsgf, where: opts[:where], min_score: opts[:min_score]}}
  end

  @impl true
  @spec detect(t(), String.t()) :: {:ok, Intent.t()} | {:error, Error.t()}
  def detect(%__MODULE__{} = grammar, text) do
    words = text |> Utterance.normalize_words() |> Enum.take(@most_words) |> List.to_tuple()

    matches =
      for {rule, order} <- Enum.with_index(grammar.jsgf.public),
          {from, to, tags} <- List.wrap(longest_match(grammar, rule, words)),
          score = (to - from) / tuple_size(words),
          score >= grammar.min_score,
          do: {-score, order, rule, tags}

    matches = Enum.sort(matches)

    {:ok,
     %Intent{query: text, intents: build_intents(matches), entities: build_entities(matches)}}
  end

  defp longest_match(_grammar, _rule, {}), do: nil

  defp longest_match(%{where: :whole} = grammar, rule, words) do
    size = tuple_size(words)

    with [{^size, tags} | _] <- Matcher.find_ends(grammar.jsgf, rule, words, 0),
         do: {0, size, tags},
         else: (_ -> nil)
  end

  defp longest_match(grammar, rule, words) do
    for from <- 0..(tuple_size(words) - 1),
        {to, tags} <- Enum.take(Matcher.find_ends(grammar.jsgf, rule, words, from), 1),
        to > from do
      {from, to, tags}
    end
    |> Enum.max_by(fn {from, to, _} -> {to - from, -from} end, fn -> nil end)
  end

  defp build_intents(matches) do
    for {score, _, rule, tags} <- matches do
      name = Enum.find_value(tags, rule, &intent_name/1)
      %{value: name, score: -score}
    end
    |> Enum.uniq_by(& &1.value)
  end

  defp intent_name({"intent=" <> name, _}), do: String.trim(name)
  defp intent_name(_), do: nil

  # Only the entities of the best rule are returned.
  defp build_entities([]), do: []

  defp build_entities([{score, _, _, tags} | _]) do
    for {text, words} = tag <- tags, intent_name(tag) == nil do
      case String.split(text, "=", parts: 2) do
        [key, value] -> %{type: String.trim(key), value: String.trim(value), score: -score}
        [key] -> %{type: key, value: words, score: -score}
      end
    end
  end
end
