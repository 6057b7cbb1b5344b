defmodule Situ.Infer.SpeechRecognizer do
  @schema [
    recognizer: [
      type: :module,
      default: Situ.Infer.Speech.Moonshine,
      doc: "The module that recognises, a `Situ.Infer.Speech.Recognizer`."
    ],
    recognizer_options: [type: :keyword, default: [], doc: "Options for its `load/1`."],
    partial: [
      type: {:optional, :time_ns},
      default: 300_000_000,
      doc:
        "How often there is a result while somebody speaks, ns; a tenth of what was said when " <>
          "that is longer. `nil`: none."
    ],
    margin: [
      type: :time_ns,
      default: 150_000_000,
      doc: "Sound before and after the speech that is listened to, too, ns."
    ],
    late: [
      type: {:optional, :time_ns},
      default: nil,
      doc:
        "For sound in real time: no result while somebody speaks when the sound for it is older than this, ns, so " <>
          "that a slow machine does not fall behind. `nil`: all of them."
    ],
    shortest: [
      type: :time_ns,
      default: 200_000_000,
      doc: "Shorter speech is none, ns: of a clap or a struck chord, recognisers make words."
    ],
    early: [
      type: {:optional, :time_ns},
      default: nil,
      doc:
        "Recognises already after so short a pause, ns, and has the result at hand when the pause turns out to be " <>
          "the end. For sound in real time: the answer is the same, and comes sooner for more work."
    ],
    turns: [
      type: :boolean,
      default: false,
      doc:
        "`speaking` comes from `Situ.Infer.turns/3`, which interrupts it for a moment where somebody else goes on: " <>
          "the margin ends there, and the value after a pause is waited for."
    ],
    longest: [
      type: :time_ns,
      default: 20_000_000_000,
      doc: "The longest utterance, ns: longer speech without a pause is cut."
    ]
  ]

  @moduledoc """
  Speech to text: the words between two pauses, and a partial result while somebody speaks.

  Input `:sound` is sound (`Situ.AudioBuffer`), `:speaking` whether somebody speaks, as `Situ.Infer.VoiceActivity` says:
  recognisers invent words in noise. Output `:out` is a `Situ.Infer.Speech.Utterance` at the time when the speech ended,
  `:partial` one while it goes on.

      speaking = Situ.Infer.voice_activity(sound)
      heard = Situ.via([sound: sound, speaking: speaking], Situ.Infer.SpeechRecognizer)
      heard.out |> Situ.each(&IO.puts(&1.text))

  A message on the optional input `:options` (a keyword list, such as `[grammar: other]`) changes `recognizer_options`
  while it runs.

  The output depends on the messages only, not on when they arrive. `Situ.Infer.transcribe/2` adds voice activity.

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  use Situ.Component,
    inputs: [sound: Situ.AudioBuffer, speaking: :boolean, options: {:any, optional: true}],
    outputs: [out: Situ.Infer.Speech.Utterance, partial: Situ.Infer.Speech.Utterance],
    options: @schema

  alias Situ.{AudioBuffer, AudioFormat, Error}
  alias Situ.Infer.Speech.Utterance

  # A value of `speaking` is about so much sound.
  @value 32_000_000
  # Sound before anybody speaks is forgotten after this.
  @memory 2_000_000_000

  defstruct [
    :opts,
    :model,
    :now,
    sound: [],
    heard_to: nil,
    deaf?: false,
    asked: :queue.new(),
    asked_to: nil,
    answered_to: nil,
    said_to: nil,
    open: nil
  ]

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: Map.new(opts)}}

  @impl true
  def handle_start(_context, %{opts: opts} = state),
    do: {[], %{state | model: Error.unwrap!(opts.recognizer.load(opts.recognizer_options))}}

  @impl true
  def handle_message(:sound, %{data: buffer, originating_time: time}, context, state) do
    sound = [{time, buffer} | state.sound]
    answer(%{state | sound: sound, heard_to: time, now: context.now})
  end

  def handle_message(:speaking, %{data: speaking?, originating_time: time}, context, state),
    do: answer(%{ask(state, {time, speaking?}, time) | now: context.now})

  # Whatever was said before is still recognised as it was asked for then.
  def handle_message(:options, %{data: changes}, _context, state),
    do: answer(%{state | asked: :queue.in({:options, changes}, state.asked)})

  @impl true
  def handle_closed(:options, _time, _context, state), do: {[], state}

  def handle_closed(:sound, _time, _context, state), do: answer(%{state | deaf?: true})

  def handle_closed(:speaking, _time, _context, state),
    do: state |> ask(:closed, :infinity) |> answer()

  @impl true
  def describe(%{open: nil}), do: "nobody speaks"
  def describe(_state), do: "somebody speaks"

  defp ask(state, value, to), do: %{state | asked: :queue.in(value, state.asked), asked_to: to}

  # Each value of `speaking` is handled once the sound around it has come; other options come in between.
  defp answer(state) do
    case :queue.peek(state.asked) do
      {:value, next} ->
        if ready?(state, next) do
          {actions, state} = step(next, %{state | asked: :queue.drop(state.asked)})
          {more, state} = answer(state)
          {actions ++ more, state}
        else
          {[], forget(state)}
        end

      :empty ->
        {[], state |> early() |> forget()}
    end
  end

  # Sound has come of which nobody knows yet whether it is a pause or the end.
  defp early(%{opts: %{early: early}, open: %{to: to} = open} = state) when early != nil do
    enough? = to - open.from >= state.opts.shortest

    pause? =
      enough? and state.heard_to != nil and state.heard_to - to >= max(early, state.opts.margin)

    if pause? and not match?({^to, _}, open.early), do: foresee(state), else: state
  end

  defp early(state), do: state

  defp foresee(%{open: %{to: to}} = state),
    do: put_in(state.open.early, {to, recognize(state, to + state.opts.margin)})

  defp ready?(_state, {:options, _changes}), do: true
  defp ready?(%{deaf?: true, asked_to: :infinity}, _next), do: true

  defp ready?(%{deaf?: true} = state, next),
    do: ready?(%{state | deaf?: false, heard_to: :infinity}, next)

  defp ready?(_state, :closed), do: false
  defp ready?(%{heard_to: nil}, _next), do: false

  # With turns the margin behind speech ends where the next speech begins, so that has to be known, too.
  defp ready?(%{open: open, opts: opts} = state, {time, speaking?}) do
    until = time + opts.margin
    known? = speaking? or open == nil or not opts.turns or state.asked_to >= until
    known? and state.heard_to >= until
  end

  defp step({:options, changes}, %{opts: opts} = state) do
    own = Keyword.merge(opts.recognizer_options, changes)
    model = Error.unwrap!(opts.recognizer.load(own))
    {[], %{state | model: model, opts: %{opts | recognizer_options: own}}}
  end

  defp step(:closed, %{open: nil} = state), do: {[], state}
  defp step(:closed, state), do: finish(state)

  defp step({time, true}, %{open: nil} = state) do
    # The first value of `true` covers a stretch of sound before it.
    from = max(time - @value, state.answered_to || time - @value)
    {[], %{state | open: %{from: from, to: time, said: from, early: nil}, answered_to: time}}
  end

  defp step({time, true}, %{open: open, opts: opts} = state) do
    state = %{state | open: %{open | to: time}, answered_to: time}
    length = time - open.from

    cond do
      length >= opts.longest -> cut(state)
      late?(state, time) -> {[], state}
      opts.partial && time - open.said >= max(opts.partial, div(length, 10)) -> partial(state)
      true -> {[], state}
    end
  end

  defp step({time, false}, %{open: nil} = state), do: {[], %{state | answered_to: time}}

  defp step({time, false}, state) do
    {actions, state} = finish(state)
    {actions, %{state | answered_to: time}}
  end

  defp late?(%{opts: %{late: nil}}, _time), do: false
  defp late?(%{opts: %{late: late}, now: now}, time), do: now - time > late

  defp partial(%{open: open} = state) do
    state = put_in(state.open.said, open.to)
    {said(:partial, recognize(state, open.to), open, false), state}
  end

  defp finish(%{open: %{from: from, to: to}, opts: %{shortest: shortest}} = state)
       when to - from < shortest,
       do: {[], %{state | open: nil}}

  defp finish(%{open: %{to: to, early: {to, result}}} = state), do: finished(state, result)

  defp finish(%{open: %{to: to}, opts: opts} = state),
    do: finished(state, recognize(state, max(to, min(to + opts.margin, next_begins(state)))))

  # Whoever talks for too long goes on at once: no margin.
  defp cut(state), do: finished(state, recognize(state, state.open.to))

  defp finished(%{open: open} = state, result),
    do: {said(:out, result, open, true), %{state | open: nil, said_to: open.to}}

  # Where the next utterance begins, if that is near: its words are not this one's.
  defp next_begins(%{opts: %{turns: false}}), do: :infinity

  defp next_begins(%{asked: asked}) do
    case Enum.find(:queue.to_list(asked), &match?({_, true}, &1)) do
      {time, true} -> time - @value
      nil -> :infinity
    end
  end

  defp said(_output, %{text: ""}, _open, _final?), do: []

  defp said(output, %{text: text, confidence: confidence} = result, open, final?) do
    words = for word <- result[:words] || [], do: placed(word, result.begins)

    said = %Utterance{
      text: text,
      from: open.from,
      to: open.to,
      confidence: confidence,
      final?: final?,
      words: words,
      alternatives: result[:alternatives] || []
    }

    [{output, open.to, said}]
  end

  defp placed(word, begins), do: %{word | from: begins + word.from, to: begins + word.to}

  defp recognize(%{open: open, opts: opts, model: model} = state, to) do
    from = open.from - opts.margin
    from = if state.said_to, do: max(from, state.said_to), else: from

    case stretch(state.sound, from, to) do
      nil ->
        %{text: ""}

      {begins, buffer} ->
        result = Error.unwrap!(opts.recognizer.transcribe(model, buffer))
        Map.put(result, :begins, begins)
    end
  end

  # The sound between two times, and where it begins; what is missing of it is left out.
  defp stretch(sound, from, to) do
    parts =
      for {time, buffer} <- Enum.reverse(sound), part = part(buffer, time, from, to), do: part

    with [{begins, _} | _] <- parts,
         do: {begins, Error.unwrap!(AudioBuffer.concat(Enum.map(parts, &elem(&1, 1))))},
         else: (_ -> nil)
  end

  defp part(buffer, time, from, to) do
    start = AudioBuffer.start_time(buffer, time)

    if time > from and start < to do
      first = max(AudioFormat.ns_to_frames(buffer.format, from - start), 0)
      last = AudioFormat.ns_to_frames(buffer.format, min(to, time) - start)
      {max(from, start), AudioBuffer.slice(buffer, first, max(last - first, 0))}
    end
  end

  defp forget(%{heard_to: nil} = state), do: state

  defp forget(state) do
    oldest =
      case {state.open, state.answered_to} do
        {%{from: from}, _} -> from - state.opts.margin
        {nil, nil} -> nil
        {nil, time} -> time - @memory
      end

    if oldest,
      do: %{state | sound: Enum.take_while(state.sound, fn {time, _} -> time > oldest end)},
      else: state
  end
end
