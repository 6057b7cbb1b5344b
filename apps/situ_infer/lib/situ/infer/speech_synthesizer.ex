defmodule Situ.Infer.SpeechSynthesizer do
  @schema [
    synthesizer: [
      type: :module,
      default: Situ.Infer.Speech.Espeak,
      doc: "What speaks: a `Situ.Infer.Speech.Synthesizer`."
    ],
    synthesizer_options: [type: :keyword, default: [], doc: "For its `load/1`."],
    rate: [
      type: {:range, 8_000, 48_000},
      default: 16_000,
      doc: "Frames a second of the sound, Hz."
    ],
    stamp: [
      type: {:in, [:end, :text]},
      default: :end,
      doc:
        "The sound's time: that of its end, as all sound's; or that of its text, for what plays it by its own clock."
    ],
    cache: [
      type: :non_neg_integer,
      default: 64,
      doc: "How many texts are remembered with their sound."
    ]
  ]

  @moduledoc """
  Text to speech: strings in, sound out.

  Input `:in` is text, output `:out` the sound of each as one `Situ.AudioBuffer` (16-bit mono). It begins when the
  text came, or when the sound before it ends, and its time is that of its end. Texts without words give nothing; a
  text that is said again comes from memory.

      answers |> Situ.via(Situ.Infer.SpeechSynthesizer, synthesizer_options: [voice: "en-gb"])

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  use Situ.Component, inputs: [in: :string], outputs: [out: Situ.AudioBuffer], options: @schema

  alias Situ.{AudioBuffer, Error, Sound}

  defstruct [:opts, :voice, ends: nil, known: %{}, order: :queue.new()]

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: Map.new(opts)}}

  @impl true
  def handle_start(_context, %{opts: opts} = state),
    do: {[], %{state | voice: Error.unwrap!(opts.synthesizer.load(opts.synthesizer_options))}}

  @impl true
  def handle_message(:in, %{data: text, originating_time: time}, _context, state) do
    {sound, state} = sound(state, text)

    cond do
      sound.data == "" -> {[], state}
      state.opts.stamp == :text -> {[{:out, time, sound}], state}
      true -> following(sound, time, state)
    end
  end

  defp following(sound, time, state) do
    ends = max(time, state.ends || time) + AudioBuffer.duration(sound)
    {[{:out, ends, sound}], %{state | ends: ends}}
  end

  defp sound(%{known: known} = state, text) when is_map_key(known, text), do: {known[text], state}

  defp sound(%{opts: opts} = state, text) do
    spoken = Error.unwrap!(opts.synthesizer.speak(state.voice, text))
    mono = Sound.reformat!(spoken, channels: 1, sample: :s16)
    sound = if mono.data == "", do: mono, else: Sound.resample!(mono, opts.rate)
    {sound, remember(state, text, sound)}
  end

  defp remember(%{opts: %{cache: 0}} = state, _text, _sound), do: state

  defp remember(%{known: known, order: order, opts: opts} = state, text, sound) do
    {known, order} =
      if map_size(known) < opts.cache do
        {known, order}
      else
        {{:value, oldest}, order} = :queue.out(order)
        {Map.delete(known, oldest), order}
      end

    %{state | known: Map.put(known, text, sound), order: :queue.in(text, order)}
  end
end
