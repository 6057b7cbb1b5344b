defmodule Situ.Assistant.Dialogue do
  @moduledoc false
  # Manages the conversation: decides whether a sentence is addressed to the assistant, detects
  # its intent, and acts.
  #
  # Input `:heard` contains recognized utterances (`Situ.Infer.Speech.Utterance`). Outputs are
  # `:intent` (detected intents), `:said` (replies) and `:ask` (questions for a language model).
  # Timers use the pipeline's clock.
  #
  # The name is matched approximately: about one wrong letter in six is tolerated. Echoes of the
  # assistant's own speech are ignored.

  @schema [
    wake: [
      type: {:optional, :string},
      default: "computer",
      doc: "The assistant's name; with `nil` it responds to every sentence."
    ],
    attention: [
      type: :time_ns,
      default: 8_000_000_000,
      doc: "How long the name may be omitted after the name or a reply, ns."
    ],
    grammar: [
      type: {:optional, :string},
      default: nil,
      doc:
        "Additional commands: a grammar (`Situ.Intent.Grammar`) or its file; their intents are emitted on `:intent`."
    ],
    ask: [type: :boolean, default: false, doc: "Emit sentences that no rule matches on `:ask`."],
    local_time: [
      type: {:optional, {:fun, 1}},
      default: nil,
      doc:
        "Converts a time (ns) to the assistant's local `{date, time}`; `nil` uses the machine's time zone."
    ]
  ]

  use Situ.Component,
    inputs: [heard: Situ.Infer.Speech.Utterance],
    outputs: [intent: Situ.Intent, said: :string, ask: :string],
    options: @schema

  alias Situ.Assistant.{EchoDetector, Skills}
  alias Situ.Infer.Speech.Utterance
  alias Situ.Intent
  alias Situ.Intent.Grammar

  # The minimum Jaro similarity of two words that count as equal.
  @alike 0.88

  defstruct [
    :opts,
    :grammars,
    :wake,
    attention_to: nil,
    echo: EchoDetector.new(),
    timers: %{},
    next_timer: 0,
    last_reply: nil
  ]

  @impl true
  def init(opts) do
    with {:ok, own} <- Grammar.load(grammar: Skills.grammar(), min_score: 0.5),
         {:ok, more} <- load_grammar(opts[:grammar]) do
      wake = opts[:wake] && Utterance.normalize_words(opts[:wake])
      {:ok, %__MODULE__{opts: Map.new(opts), grammars: more ++ [own], wake: wake}}
    end
  end

  defp load_grammar(nil), do: {:ok, []}

  defp load_grammar(grammar) do
    with {:ok, grammar} <- Grammar.load(grammar: grammar, min_score: 0.5), do: {:ok, [grammar]}
  end

  @impl true
  def handle_message(:heard, %{data: utterance, originating_time: time}, _context, state) do
    if EchoDetector.own_words?(state.echo, utterance.from, utterance.text),
      do: {[], state},
      else: utterance.text |> match_wake_name(state.wake) |> handle_heard(utterance, time, state)
  end

  # An empty text means that the user said only the name.
  defp handle_heard({:called, ""}, _utterance, time, state),
    do: emit_reply("Yes?", time, extend_attention(state, time))

  defp handle_heard({:called, text}, _utterance, time, state),
    do: handle_command(text, time, state)

  defp handle_heard(:not_called, utterance, time, state) do
    if state.wake in [nil, []] or
         (state.attention_to != nil and utterance.from <= state.attention_to),
       do: handle_command(utterance.text, time, state),
       else: {[], state}
  end

  defp handle_command(text, time, state) do
    intent = detect_intent(text, state.grammars)

    {actions, state} =
      apply_action(
        Skills.answer_intent(intent, to_local_time(time, state.opts.local_time)),
        text,
        time,
        intent,
        state
      )

    {[{:intent, time, intent} | actions], state}
  end

  defp to_local_time(ns, nil), do: :calendar.system_time_to_local_time(ns, :nanosecond)
  defp to_local_time(ns, convert), do: convert.(ns)

  defp detect_intent(text, grammars) do
    Enum.reduce_while(grammars, nil, fn grammar, _ ->
      {:ok, intent} = Grammar.detect(grammar, text)
      if Intent.name(intent), do: {:halt, intent}, else: {:cont, intent}
    end)
  end

  defp apply_action({:say, text}, _text, time, _intent, state),
    do: emit_reply(text, time, extend_attention(state, time))

  defp apply_action({:timer, length, name, text}, _text, time, _intent, state) do
    {actions, say} = emit_reply(text, time, extend_attention(state, time))
    timers = Map.put(say.timers, say.next_timer, name)

    {actions ++ [{:timer, {:rings, say.next_timer}, time + length}],
     %{say | timers: timers, next_timer: say.next_timer + 1}}
  end

  defp apply_action(:cancel, _text, time, _intent, %{timers: timers} = state) do
    text =
      if timers == %{},
        do: "No timer is set.",
        else: "I canceled the #{if map_size(timers) > 1, do: "timers", else: "timer"}."

    emit_reply(text, time, extend_attention(%{state | timers: %{}}, time))
  end

  defp apply_action(:quiet, _text, _time, _intent, state), do: {[], %{state | attention_to: nil}}

  # A model's reply may be long and is not in `echo`, so the user must say the name to continue.
  defp apply_action(:unknown, text, time, %{intents: []}, %{opts: %{ask: true}} = state),
    do: {[{:ask, time, text}], %{state | attention_to: nil}}

  defp apply_action(:unknown, _text, time, %{intents: []}, state),
    do: emit_reply("I did not understand that.", time, extend_attention(state, time))

  # The intent belongs to the surrounding program, which reacts to it.
  defp apply_action(:unknown, _text, time, _intent, state),
    do: {[], extend_attention(state, time)}

  defp extend_attention(state, time), do: %{state | attention_to: time + state.opts.attention}

  @impl true
  def handle_info({:timer, {:rings, id}}, context, state) do
    case Map.pop(state.timers, id) do
      {nil, _} ->
        {[], state}

      {name, timers} ->
        emit_reply("Your timer of #{name} is over.", context.now, %{state | timers: timers})
    end
  end

  def handle_info(_other, _context, state), do: {[], state}

  @impl true
  def describe(state), do: "#{map_size(state.timers)} timers"

  defp emit_reply(text, time, state) do
    at = if state.last_reply, do: max(time, state.last_reply + 1), else: time

    {[{:said, at, text}],
     %{state | last_reply: at, echo: EchoDetector.add_text(state.echo, at, text)}}
  end

  @doc """
  Returns the words after the assistant's name if the text begins with the name; a preceding greeting is skipped.

      iex> Situ.Assistant.Dialogue.match_wake_name("Hey, Computer! What time is it?", ["computer"])
      {:called, "what time is it"}
      iex> Situ.Assistant.Dialogue.match_wake_name("My computer is broken.", ["computer"])
      :not_called
  """
  @spec match_wake_name(String.t(), [String.t()] | nil) :: {:called, String.t()} | :not_called
  def match_wake_name(_text, wake) when wake in [nil, []], do: :not_called

  def match_wake_name(text, wake) do
    words =
      text
      |> Utterance.normalize_words()
      |> Enum.drop_while(&(&1 in ["hey", "hi", "hello", "ok", "okay"]))

    {name, rest} = Enum.split(words, length(wake))

    if Utterance.similar_words?(name, wake, @alike),
      do: {:called, Enum.join(rest, " ")},
      else: :not_called
  end
end
