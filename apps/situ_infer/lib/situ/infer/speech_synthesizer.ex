defmodule Situ.Infer.SpeechSynthesizer do
  @moduledoc """
  Converts text to speech.

  Input `:in` is text. Output `:out` is the audio of each text as one `Situ.AudioBuffer` (16-bit mono). It starts when
  the text arrives, or when the previous audio ends, and its time is the time of its end. Texts without words produce no
  audio, and the audio of a repeated text comes from a cache.

      answers |> Situ.via(Situ.Infer.SpeechSynthesizer, synthesizer_options: [voice: "en-gb"]).out

  With `marks: true`, the outputs `:words`, `:phonemes` and `:bookmarks` are `Situ.Infer.Speech.Mark`s, each at the time
  when it starts to be spoken. Not every synthesizer supports them
  (`c:Situ.Infer.Speech.Synthesizer.speak_with_marks/2`). `Situ.Annotation.Spans` converts them to annotations.

  The audio is emitted as soon as it is synthesized, however long it is.
  """

  @schema [
    synthesizer: [
      type: :module,
      default: Situ.Infer.Speech.Espeak,
      doc: "The module that synthesizes speech, a `Situ.Infer.Speech.Synthesizer`."
    ],
    synthesizer_options: [type: :keyword, default: [], doc: "Options for its `load/1`."],
    rate: [
      type: {:range, 8_000, 48_000},
      default: 16_000,
      doc: "The sample rate of the audio, in Hz."
    ],
    stamp: [
      type: {:in, [:end, :text]},
      default: :end,
      doc:
        "The time of the audio: its end, as for all audio, or the time of its text, for players with their own clock."
    ],
    marks: [
      type: :boolean,
      default: false,
      doc: "Whether to emit the times of words and phonemes; not allowed with `stamp: :text`."
    ],
    cache: [
      type: :non_neg_integer,
      default: 64,
      doc: "The number of texts whose audio is cached."
    ]
  ]

  use Situ.Component,
    inputs: [in: :string],
    outputs: [
      out: Situ.AudioBuffer,
      words: Situ.Infer.Speech.Mark,
      phonemes: Situ.Infer.Speech.Mark,
      bookmarks: Situ.Infer.Speech.Mark
    ],
    options: @schema

  alias Situ.{AudioBuffer, Error, AudioOps}
  alias Situ.Infer.Speech.Mark

  @outputs %{word: :words, phoneme: :phonemes, mark: :bookmarks}

  defstruct [
    :opts,
    :voice,
    audio_to: nil,
    last_marks: %{},
    audio_cache: %{},
    cache_order: :queue.new()
  ]

  @impl true
  def init(opts) do
    if opts[:marks] and opts[:stamp] == :text,
      do:
        {:error,
         Error.new(:bad_option, "marks: cannot be combined with stamp: :text",
           fix: "leave out stamp: :text, or marks:"
         )},
      else: {:ok, %__MODULE__{opts: Map.new(opts)}}
  end

  @impl true
  def handle_start(_context, %{opts: opts} = state) do
    voice = Error.unwrap!(opts.synthesizer.load(opts.synthesizer_options))

    if opts.marks and not function_exported?(opts.synthesizer, :speak_with_marks, 2) do
      raise Error.new(
              :no_marks,
              "#{inspect(opts.synthesizer)} does not support the times of words",
              fix: "use Situ.Infer.Speech.Espeak, or leave out marks:"
            )
    end

    {[], %{state | voice: voice}}
  end

  @impl true
  def handle_message(:in, %{data: text, originating_time: time}, _context, state) do
    {{sound, marks}, state} = fetch_audio(state, text)

    cond do
      sound.data == "" -> {[], state}
      state.opts.stamp == :text -> {[{:out, time, sound}], state}
      true -> schedule_audio(sound, marks, time, state)
    end
  end

  defp schedule_audio(sound, marks, time, state) do
    begins = max(time, state.audio_to || time)
    ends = begins + AudioBuffer.duration_ns(sound)

    {actions, last} =
      marks
      |> Enum.filter(&is_map_key(@outputs, &1.kind))
      |> Enum.map_reduce(state.last_marks, fn mark, last ->
        output = @outputs[mark.kind]
        mark = Mark.shift(mark, begins)
        # Two marks may have the same position in the text.
        at = max(mark.from, Map.get(last, output, mark.from - 1) + 1)
        {{output, at, mark}, Map.put(last, output, at)}
      end)

    {actions ++ [{:out, ends, sound}], %{state | audio_to: ends, last_marks: last}}
  end

  defp fetch_audio(%{audio_cache: audio_cache} = state, text) when is_map_key(audio_cache, text),
    do: {audio_cache[text], state}

  defp fetch_audio(%{opts: opts} = state, text) do
    {audio, marks} = synthesize_text(opts, state.voice, text)
    mono = AudioOps.reformat!(audio, channels: 1, sample: :s16)
    sound = if mono.data == "", do: mono, else: AudioOps.resample!(mono, opts.rate)
    {{sound, marks}, cache_audio(state, text, {sound, marks})}
  end

  defp synthesize_text(%{marks: false, synthesizer: synthesizer}, voice, text),
    do: {Error.unwrap!(synthesizer.speak(voice, text)), []}

  defp synthesize_text(%{synthesizer: synthesizer}, voice, text) do
    case synthesizer.speak_with_marks(voice, text) do
      {:ok, sound, marks} -> {sound, marks}
      {:error, error} -> raise error
    end
  end

  defp cache_audio(%{opts: %{cache: 0}} = state, _text, _sound), do: state

  defp cache_audio(
         %{audio_cache: audio_cache, cache_order: order, opts: opts} = state,
         text,
         sound
       ) do
    {audio_cache, order} =
      if map_size(audio_cache) < opts.cache do
        {audio_cache, order}
      else
        {{:value, oldest}, order} = :queue.out(order)
        {Map.delete(audio_cache, oldest), order}
      end

    %{state | audio_cache: Map.put(audio_cache, text, sound), cache_order: :queue.in(text, order)}
  end
end
