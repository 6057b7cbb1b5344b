defmodule Situ.Infer.SpeechRecognizer do
  @moduledoc """
  Converts speech to text: the words between two pauses, and partial results during speech.

  Input `:sound` is audio (`Situ.AudioBuffer`). Input `:speaking` is whether somebody speaks, from
  `Situ.Infer.VoiceActivity`, because recognizers invent words in noise. Output `:out` is a
  `Situ.Infer.Speech.Utterance` at the time when the speech ended; `:partial` emits one during the speech.

      speaking = Situ.Infer.voice_activity(sound)
      heard = Situ.via([sound: sound, speaking: speaking], Situ.Infer.SpeechRecognizer)
      heard.out |> Situ.each(&IO.puts(&1.text))

  A message on the optional input `:options` (a keyword list, such as `[grammar: other]`) changes `recognizer_options`
  at run time.

  The output depends on the messages only, not on when they arrive. `Situ.Infer.transcribe/2` adds voice activity.
  """

  @schema [
    recognizer: [
      type: :module,
      default: Situ.Infer.Speech.Moonshine,
      doc: "The module that recognizes speech, a `Situ.Infer.Speech.Recognizer`."
    ],
    recognizer_options: [type: :keyword, default: [], doc: "Options for its `load/1`."],
    partial: [
      type: {:optional, :time_ns},
      default: 300_000_000,
      doc:
        "How often a partial result is emitted during speech, in ns; a tenth of the speech so far if that " <>
          "is longer. `nil`: never."
    ],
    margin: [
      type: :time_ns,
      default: 150_000_000,
      doc: "How much audio before and after the speech is also transcribed, in ns."
    ],
    late: [
      type: {:optional, :time_ns},
      default: nil,
      doc:
        "For live audio: skips partial results whose audio is older than this, in ns, so that a slow machine " <>
          "keeps up. `nil`: skips none."
    ],
    shortest: [
      type: :time_ns,
      default: 200_000_000,
      doc:
        "Shorter speech is ignored, in ns; recognizers turn a clap or a struck chord into words."
    ],
    early: [
      type: {:optional, :time_ns},
      default: nil,
      doc:
        "Recognizes after a pause of this length, in ns, so that the result is ready if the pause turns out to be " <>
          "the end. For live audio: the result is the same, and comes sooner at the cost of more work."
    ],
    turns: [
      type: :boolean,
      default: false,
      doc:
        "Whether `speaking` comes from `Situ.Infer.turns/3`, which interrupts it for a moment where another person " <>
          "takes over. The margin then ends there, and the value after a pause is waited for."
    ],
    longest: [
      type: :time_ns,
      default: 20_000_000_000,
      doc: "The longest utterance, in ns; longer speech without a pause is cut."
    ]
  ]

  use Situ.Component,
    inputs: [sound: Situ.AudioBuffer, speaking: :boolean, options: {:any, optional: true}],
    outputs: [out: Situ.Infer.Speech.Utterance, partial: Situ.Infer.Speech.Utterance],
    options: @schema

  alias Situ.{AudioBuffer, AudioFormat, Error}
  alias Situ.Infer.Speech.Utterance

  # The length of audio that one value of `speaking` covers.
  @value 32_000_000
  # Audio from before any speech is dropped after this time.
  @memory 2_000_000_000

  defstruct [
    :opts,
    :model,
    :now,
    sound: [],
    sound_to: nil,
    sound_closed?: false,
    queue: :queue.new(),
    queued_to: nil,
    handled_to: nil,
    recognized_to: nil,
    utterance: nil
  ]

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: Map.new(opts)}}

  @impl true
  def handle_start(_context, %{opts: opts} = state),
    do: {[], %{state | model: Error.unwrap!(opts.recognizer.load(opts.recognizer_options))}}

  @impl true
  def handle_message(:sound, %{data: buffer, originating_time: time}, context, state) do
    sound = [{time, buffer} | state.sound]
    handle_queue(%{state | sound: sound, sound_to: time, now: context.now})
  end

  def handle_message(:speaking, %{data: speaking?, originating_time: time}, context, state),
    do: handle_queue(%{queue_value(state, {time, speaking?}, time) | now: context.now})

  # Earlier speech is still recognized with the options that were valid then.
  def handle_message(:options, %{data: changes}, _context, state),
    do: handle_queue(%{state | queue: :queue.in({:options, changes}, state.queue)})

  @impl true
  def handle_closed(:options, _time, _context, state), do: {[], state}

  def handle_closed(:sound, _time, _context, state),
    do: handle_queue(%{state | sound_closed?: true})

  def handle_closed(:speaking, _time, _context, state),
    do: state |> queue_value(:closed, :infinity) |> handle_queue()

  @impl true
  def describe(%{utterance: nil}), do: "nobody speaks"
  def describe(_state), do: "somebody speaks"

  defp queue_value(state, value, to),
    do: %{state | queue: :queue.in(value, state.queue), queued_to: to}

  # Each value of `speaking` is handled once the audio around it has arrived; option changes keep their order.
  defp handle_queue(state) do
    case :queue.peek(state.queue) do
      {:value, next} ->
        if can_handle?(state, next) do
          {actions, state} = handle_value(next, %{state | queue: :queue.drop(state.queue)})
          {more, state} = handle_queue(state)
          {actions ++ more, state}
        else
          {[], drop_old_audio(state)}
        end

      :empty ->
        {[], state |> recognize_early() |> drop_old_audio()}
    end
  end

  # There is newer audio for which it is not yet known whether it is a pause or the end.
  defp recognize_early(%{opts: %{early: early}, utterance: %{to: to} = utterance} = state)
       when early != nil do
    enough? = to - utterance.from >= state.opts.shortest

    pause? =
      enough? and state.sound_to != nil and state.sound_to - to >= max(early, state.opts.margin)

    if pause? and not match?({^to, _}, utterance.early),
      do: store_early_result(state),
      else: state
  end

  defp recognize_early(state), do: state

  defp store_early_result(%{utterance: %{to: to}} = state),
    do: put_in(state.utterance.early, {to, recognize_until(state, to + state.opts.margin)})

  defp can_handle?(_state, {:options, _changes}), do: true
  defp can_handle?(%{sound_closed?: true, queued_to: :infinity}, _next), do: true

  defp can_handle?(%{sound_closed?: true} = state, next),
    do: can_handle?(%{state | sound_closed?: false, sound_to: :infinity}, next)

  defp can_handle?(_state, :closed), do: false
  defp can_handle?(%{sound_to: nil}, _next), do: false

  # With turns, the margin after speech ends where the next speech starts, so that must be known, too.
  defp can_handle?(%{utterance: utterance, opts: opts} = state, {time, speaking?}) do
    until = time + opts.margin
    known? = speaking? or utterance == nil or not opts.turns or state.queued_to >= until
    known? and state.sound_to >= until
  end

  defp handle_value({:options, changes}, %{opts: opts} = state) do
    own = Keyword.merge(opts.recognizer_options, changes)
    model = Error.unwrap!(opts.recognizer.load(own))
    {[], %{state | model: model, opts: %{opts | recognizer_options: own}}}
  end

  defp handle_value(:closed, %{utterance: nil} = state), do: {[], state}
  defp handle_value(:closed, state), do: finish_utterance(state)

  defp handle_value({time, true}, %{utterance: nil} = state) do
    # The first value of `true` covers the audio before it.
    from = max(time - @value, state.handled_to || time - @value)

    {[],
     %{state | utterance: %{from: from, to: time, partial_to: from, early: nil}, handled_to: time}}
  end

  defp handle_value({time, true}, %{utterance: utterance, opts: opts} = state) do
    state = %{state | utterance: %{utterance | to: time}, handled_to: time}
    length = time - utterance.from

    cond do
      length >= opts.longest ->
        cut_utterance(state)

      too_late?(state, time) ->
        {[], state}

      opts.partial && time - utterance.partial_to >= max(opts.partial, div(length, 10)) ->
        emit_partial(state)

      true ->
        {[], state}
    end
  end

  defp handle_value({time, false}, %{utterance: nil} = state),
    do: {[], %{state | handled_to: time}}

  defp handle_value({time, false}, state) do
    {actions, state} = finish_utterance(state)
    {actions, %{state | handled_to: time}}
  end

  defp too_late?(%{opts: %{late: nil}}, _time), do: false
  defp too_late?(%{opts: %{late: late}, now: now}, time), do: now - time > late

  defp emit_partial(%{utterance: utterance} = state) do
    state = put_in(state.utterance.partial_to, utterance.to)
    {emit_utterance(:partial, recognize_until(state, utterance.to), utterance, false), state}
  end

  defp finish_utterance(%{utterance: %{from: from, to: to}, opts: %{shortest: shortest}} = state)
       when to - from < shortest,
       do: {[], %{state | utterance: nil}}

  defp finish_utterance(%{utterance: %{to: to, early: {to, result}}} = state),
    do: emit_final(state, result)

  defp finish_utterance(%{utterance: %{to: to}, opts: opts} = state),
    do:
      emit_final(
        state,
        recognize_until(state, max(to, min(to + opts.margin, next_begins(state))))
      )

  # Speech that is cut at the maximum length continues without a pause, so there is no margin.
  defp cut_utterance(state), do: emit_final(state, recognize_until(state, state.utterance.to))

  defp emit_final(%{utterance: utterance} = state, result),
    do:
      {emit_utterance(:out, result, utterance, true),
       %{state | utterance: nil, recognized_to: utterance.to}}

  # Returns the start of the next utterance if that is near, since its words do not belong to this one.
  defp next_begins(%{opts: %{turns: false}}), do: :infinity

  defp next_begins(%{queue: queue}) do
    case Enum.find(:queue.to_list(queue), &match?({_, true}, &1)) do
      {time, true} -> time - @value
      nil -> :infinity
    end
  end

  defp emit_utterance(_output, %{text: ""}, _open, _final?), do: []

  defp emit_utterance(output, %{text: text, confidence: confidence} = result, utterance, final?) do
    words = for word <- result[:words] || [], do: shift_word(word, result.begins)

    message = %Utterance{
      text: text,
      from: utterance.from,
      to: utterance.to,
      confidence: confidence,
      final?: final?,
      words: words,
      alternatives: result[:alternatives] || []
    }

    [{output, utterance.to, message}]
  end

  defp shift_word(word, begins), do: %{word | from: begins + word.from, to: begins + word.to}

  defp recognize_until(%{utterance: utterance, opts: opts, model: model} = state, to) do
    from = utterance.from - opts.margin
    from = if state.recognized_to, do: max(from, state.recognized_to), else: from

    case slice_audio(state.sound, from, to) do
      nil ->
        %{text: ""}

      {begins, buffer} ->
        result = Error.unwrap!(opts.recognizer.transcribe(model, buffer))
        Map.put(result, :begins, begins)
    end
  end

  # Returns the audio between two times and its start; missing audio is left out.
  defp slice_audio(sound, from, to) do
    parts =
      for {time, buffer} <- Enum.reverse(sound),
          part = slice_buffer(buffer, time, from, to),
          do: part

    with [{begins, _} | _] <- parts,
         do: {begins, Error.unwrap!(AudioBuffer.concat(Enum.map(parts, &elem(&1, 1))))},
         else: (_ -> nil)
  end

  defp slice_buffer(buffer, time, from, to) do
    start = AudioBuffer.start_time(buffer, time)

    if time > from and start < to do
      first = max(AudioFormat.ns_to_frames(buffer.format, from - start), 0)
      last = AudioFormat.ns_to_frames(buffer.format, min(to, time) - start)
      {max(from, start), AudioBuffer.slice_frames(buffer, first, max(last - first, 0))}
    end
  end

  defp drop_old_audio(%{sound_to: nil} = state), do: state

  defp drop_old_audio(state) do
    oldest =
      case {state.utterance, state.handled_to} do
        {%{from: from}, _} -> from - state.opts.margin
        {nil, nil} -> nil
        {nil, time} -> time - @memory
      end

    if oldest,
      do: %{state | sound: Enum.take_while(state.sound, fn {time, _} -> time > oldest end)},
      else: state
  end
end
