defmodule Situ.AudioStream.Analyzer do
  @moduledoc false
  # Extracts acoustic features. It is the component of `Situ.AudioStream.features/2`, which documents them.
  #
  # The definitions follow \psi, with its errors fixed. Silence and bins without power do not make the entropy NaN
  # (silence has entropy 0). The dither is seeded by the frame number, so results do not depend on how the audio was
  # divided into buffers. The spectrum is the textbook transform (\psi's is its conjugate, packed in fours).

  @hz {:range, 0, 8_000_000}
  @schema [
    frame: [type: {:range, 0.0001, 10}, default: 0.025, doc: "Length of a frame, seconds."],
    frame_rate: [type: {:range, 0.1, 10_000}, default: 100, doc: "Frames per second."],
    dither: [
      type: {:range, 0, 1_000_000},
      default: 1.0,
      doc: "Amplitude of the added noise, in units of a 16-bit sample; 0 for none."
    ],
    start_hz: [type: @hz, default: 250, doc: "Lower limit of all bands."],
    end_hz: [type: @hz, default: 7000, doc: "Upper limit of the full band and the high band."],
    low_end_hz: [type: @hz, default: 3000, doc: "Upper limit of the low band."],
    high_start_hz: [type: @hz, default: 2500, doc: "Lower limit of the high band."],
    entropy_hz: [type: @hz, default: 2500, doc: "Width of the band for the entropy."],
    spectrum: [type: :boolean, default: false, doc: "Emit the Fourier transform."],
    power: [type: :boolean, default: false, doc: "Emit its squared magnitudes."],
    mel_bands: [type: {:integer, 0, 1024}, default: 0, doc: "Mel bands to emit; 0 for none."],
    mfcc: [
      type: {:integer, 0, 1024},
      default: 0,
      doc: "Cepstral coefficients, at most `mel_bands`."
    ],
    mel_low_hz: [type: @hz, default: 0, doc: "Lower limit of the mel bands."],
    mel_high_hz: [type: {:optional, @hz}, default: nil, doc: "Upper limit; `nil`: half the rate."]
  ]

  use Situ.Component,
    inputs: [in: Situ.AudioBuffer],
    outputs: [
      log_energy: :float,
      zero_crossing_rate: :float,
      energy: :float,
      low_energy: :float,
      high_energy: :float,
      entropy: :float,
      spectrum: {:list, {:tuple, [:float, :float]}},
      power: {:list, :float},
      log_mel: {:list, :float},
      mfcc: {:list, :float}
    ],
    options: @schema

  alias Situ.{AudioBuffer, AudioFormat, Error}
  alias Situ.Media.NativeKernel
  alias Situ.AudioOps.Channels

  @enforce_keys [:native, :format, :config, :outputs]
  defstruct [:native, :format, :config, :outputs]

  @type t :: %__MODULE__{
          native: reference(),
          format: AudioFormat.t(),
          config: map(),
          outputs: [atom()]
        }

  @outputs [:log_energy, :zero_crossing_rate, :energy, :low_energy, :high_energy, :entropy] ++
             [:spectrum, :power, :log_mel, :mfcc]

  @doc "Builds an analyzer for a format, and computes its windows, filters and transform in advance."
  @spec new(AudioFormat.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def new(%AudioFormat{} = format, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, format} <- AudioFormat.validate(format),
         config = feature_config(format, opts),
         {:ok, native} <- NativeKernel.run_audio({:new_analyzer, config}, 1000) do
      {:ok,
       %__MODULE__{
         native: native,
         format: format,
         config: config,
         outputs: requested_outputs(opts)
       }}
    end
  end

  # Rounds half up by adding 0.5 and truncating, as the definition requires.
  defp feature_config(format, opts) do
    %{
      rate: format.rate,
      channels: format.channels,
      sample: format.sample,
      frame: trunc(format.rate * opts[:frame] + 0.5),
      shift: trunc(format.rate / opts[:frame_rate] + 0.5),
      dither_scale: opts[:dither] * 1.0,
      start_hz: opts[:start_hz] * 1.0,
      end_hz: opts[:end_hz] * 1.0,
      low_end_hz: opts[:low_end_hz] * 1.0,
      high_start_hz: opts[:high_start_hz] * 1.0,
      entropy_bandwidth_hz: opts[:entropy_hz] * 1.0,
      mel_bands: round(opts[:mel_bands]),
      cepstra: round(opts[:mfcc]),
      mel_low_hz: opts[:mel_low_hz] * 1.0,
      mel_high_hz: (opts[:mel_high_hz] || format.rate / 2) * 1.0
    }
  end

  defp requested_outputs(opts) do
    [
      spectrum: opts[:spectrum],
      power: opts[:power],
      log_mel: opts[:mel_bands] > 0,
      mfcc: opts[:mfcc] > 0
    ]
    |> Enum.filter(&elem(&1, 1))
    |> Keyword.keys()
  end

  @doc """
  Returns the features of every complete frame in a buffer, as maps keyed by output name. `first` is the number of the
  first frame and seeds the dither.

      iex> buffer = Situ.AudioBuffer.build_silence(Situ.AudioFormat.pcm(16_000), 400)
      iex> {:ok, analyzer} = Situ.AudioStream.Analyzer.new(buffer.format, dither: 0)
      iex> {:ok, [frame]} = Situ.AudioStream.Analyzer.extract_features(analyzer, buffer)
      iex> {frame.log_energy, frame.entropy}
      {-92.1, 0.0}
  """
  @spec extract_features(t(), AudioBuffer.t(), non_neg_integer()) ::
          {:ok, [map()]} | {:error, Error.t()}
  def extract_features(analyzer, buffer, first \\ 0)

  def extract_features(
        %__MODULE__{format: format} = a,
        %AudioBuffer{format: format} = buffer,
        first
      ) do
    # The estimate is 10 us per frame.
    frames = div(AudioBuffer.frame_count(buffer), a.config.shift)

    {:analyze, a.native, buffer.data, first, a.outputs}
    |> NativeKernel.run_audio(frames * 10)
    |> Channels.name_bad_samples(buffer, "analyze")
  end

  # The component

  @impl true
  def init(opts), do: {:ok, %{opts: opts, analyzer: nil, rest: "", index: 0, last: nil}}

  @impl true
  def handle_message(:in, %{data: buffer, originating_time: time}, _context, state) do
    state = ensure_analyzer(state, buffer.format)
    %{analyzer: analyzer, rest: rest, index: index} = state
    joined_buffer = %AudioBuffer{format: buffer.format, data: rest <> buffer.data}
    frames = Situ.Error.unwrap!(extract_features(analyzer, joined_buffer, index))
    {actions, last} = emit_features(frames, joined_buffer, time, state)
    used = length(frames) * analyzer.config.shift

    left =
      AudioBuffer.slice_frames(joined_buffer, used, AudioBuffer.frame_count(joined_buffer)).data

    {actions, %{state | rest: :binary.copy(left), index: index + length(frames), last: last}}
  end

  defp ensure_analyzer(%{analyzer: %{format: format}} = state, format), do: state

  defp ensure_analyzer(state, format) do
    analyzer = Situ.Error.unwrap!(new(format, state.opts))
    %{state | analyzer: analyzer, rest: "", index: 0}
  end

  defp emit_features(frames, joined_buffer, time, %{analyzer: %{config: config}} = state) do
    total = AudioBuffer.frame_count(joined_buffer)

    {actions, {_end, last}} =
      Enum.flat_map_reduce(frames, {config.frame, state.last}, fn frame, {stop, last} ->
        at = time - AudioFormat.frames_to_ns(joined_buffer.format, total - stop)
        at = if last, do: max(at, last + 1), else: at
        {output_actions(frame, at), {stop + config.shift, at}}
      end)

    {actions, last}
  end

  defp output_actions(frame, at) do
    for output <- @outputs, value = Map.fetch!(frame, output), do: {output, at, value}
  end
end
