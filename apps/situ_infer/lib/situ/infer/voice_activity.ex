defmodule Situ.Infer.VoiceActivity do
  @moduledoc """
  Detects whether somebody speaks.

  Input `:in` is 16 kHz mono audio (`Situ.AudioBuffer`, 16-bit or float; any buffer length). Every 32 ms of audio
  produce a message on each of the first two outputs, at the time of their end.

  | output | content | delay |
  |---|---|---|
  | `:voice` | a struct with `probability`, that somebody speaks (0..1), and `level`, the root mean square (0..1) | none |
  | `:speaking` | a boolean: whether somebody speaks | up to `:min_silence` |
  | `:segments` | after each segment of speech, a struct with its `start` and `stop` (ns) | up to `:min_silence` |

      %{speaking: speaking, segments: segments} =
        Situ.via(microphone, Situ.Infer.VoiceActivity, min_silence: Situ.Time.ms(400))

  Two thresholds prevent flickering of `:speaking`; short bursts are ignored, and short pauses are part of the speech.
  Whether a pause is short is known only after it. With `decide: :exact`, the values of a pause are therefore held back,
  and the result is the same for a live stream and a recording.

  `Situ.Infer.voice/2` and `Situ.Infer.voice_activity/2` do the same, but return a single output. A gap of more than
  0.1 s in the audio resets the detector. Silero takes about 0.15 ms per message, on the component's own scheduler.

  ## Errors

  `:bad_audio_format` (resample first), and the errors of `Situ.Infer.Model`.
  """

  @schema [
            detector: [
              type: {:or, [{:in, [:silero, :energy]}, :module]},
              default: :silero,
              doc:
                "`:silero` (a network, `model:`), `:energy` (the level above the noise, without a model), or a " <>
                  "`Situ.Infer.Voice.Detector`."
            ],
            above_db: [
              type: :number,
              default: 9.0,
              doc: "`:energy`: the level above the noise that is speech with probability 0.5."
            ],
            rise_db_per_s: [
              type: :number,
              default: 4.0,
              doc: "`:energy`: how fast the noise floor follows a louder noise."
            ]
          ] ++ Situ.Infer.BundledModel.schema() ++ Situ.Infer.VoiceGate.schema()

  use Situ.Component,
    inputs: [in: Situ.AudioBuffer],
    outputs: [
      voice: Situ.Infer.Voice,
      speaking: :boolean,
      segments: Situ.Infer.VoiceSegment
    ],
    options: @schema

  alias Situ.Infer.{Model, Voice, VoiceGate, VoiceSegment}
  alias Situ.Infer.Voice.{Chunker, Energy, Silero}

  defstruct [:opts, :chunker, :detector, :gate]

  @impl true
  def init(opts) do
    gate = VoiceGate.new(Keyword.take(opts, Keyword.keys(VoiceGate.schema())))
    {:ok, %__MODULE__{opts: opts, chunker: Chunker.new(Silero.chunk_samples()), gate: gate}}
  end

  @impl true
  def handle_start(_context, state), do: {[], %{state | detector: load_detector!(state.opts)}}

  @impl true
  def handle_message(:in, message, _context, state) do
    case Chunker.push(state.chunker, message.data, message.originating_time) do
      {:ok, chunks, gap?, chunker} ->
        state = %{state | chunker: chunker}
        {before, state} = if gap?, do: reset_detector(state), else: {[], state}
        {actions, state} = Enum.flat_map_reduce(chunks, state, &detect_chunk/2)
        {before ++ actions, state}

      {:error, error} ->
        raise error
    end
  end

  @impl true
  def handle_closed(:in, _time, _context, state) do
    {events, gate} = VoiceGate.close(state.gate)
    {to_actions(events), %{state | gate: gate}}
  end

  @impl true
  def describe(%{detector: {Silero, %{model: model}}}), do: Model.describe_runs(model)
  def describe(%{gate: gate}), do: if(VoiceGate.speech_open?(gate), do: "speech", else: "silence")

  defp load_detector!(opts) do
    module = detector_module(opts[:detector])
    {module, opts |> module.load() |> Situ.Error.unwrap!()}
  end

  defp detector_module(:silero), do: Silero
  defp detector_module(:energy), do: Energy
  defp detector_module(module), do: module

  defp detect_chunk({time, floats}, %{detector: {module, detector}} = state) do
    level = Chunker.rms_level(floats)

    case module.step(detector, floats, level) do
      {:ok, p, detector} ->
        length = Chunker.length_ns(state.chunker)
        {events, gate} = VoiceGate.push(state.gate, time, length, p)
        voice = {:voice, time, %Voice{probability: p, level: level}}
        {[voice | to_actions(events)], %{state | detector: {module, detector}, gate: gate}}

      {:error, error} ->
        raise error
    end
  end

  # Resets the detector after a gap in the audio.
  defp reset_detector(state) do
    {events, gate} = VoiceGate.close(state.gate)
    {module, detector} = state.detector
    {to_actions(events), %{state | gate: gate, detector: {module, module.reset(detector)}}}
  end

  defp to_actions(events) do
    Enum.map(events, fn
      {:segment, start, stop} -> {:segments, stop, %VoiceSegment{start: start, stop: stop}}
      {time, speaking?} -> {:speaking, time, speaking?}
    end)
  end
end
