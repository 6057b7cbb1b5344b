defmodule Situ.AudioStream.Resampler do
  @moduledoc false
  # Converts the sample rate with libsoxr, chunk by chunk, with times exact to the sample. It is the component of
  # `Situ.AudioStream.resample/3`, which documents it. Outside a pipeline, call its functions; the filter is mutable
  # native memory, so feed each filter value only once.

  @schema [
    rate: [
      type: {:integer, 1, 16_000_000},
      required: true,
      doc: "Frames per second of the result, at most 1000 times more or less than the input."
    ],
    quality: [
      type: {:in, [:quick, :low, :medium, :high, :very_high]},
      default: :high,
      doc: "The libsoxr recipe: cubic, 16 bit with a larger roll-off, 16, 20 or 28 bit."
    ]
  ]

  use Situ.Component,
    inputs: [in: Situ.AudioBuffer],
    outputs: [out: Situ.AudioBuffer],
    options: @schema

  alias Situ.{AudioBuffer, AudioFormat, Error}
  alias Situ.Media.NativeKernel
  alias Situ.AudioOps.Channels

  @enforce_keys [:native, :from, :work, :to]
  defstruct [:native, :from, :work, :to]

  @typedoc "`from` and `to` are the external formats, and `work` is the format inside the filter."
  @type t :: %__MODULE__{
          native: reference(),
          from: AudioFormat.t(),
          work: AudioFormat.t(),
          to: AudioFormat.t()
        }

  @doc """
  Builds a filter that converts `format` to another rate.

      iex> format = Situ.AudioFormat.pcm(48_000)
      iex> {:ok, filter} = Situ.AudioStream.Resampler.new(format, rate: 16_000)
      iex> {:ok, first} = Situ.AudioStream.Resampler.feed_buffer(filter, Situ.AudioBuffer.build_silence(format, 4800))
      iex> {:ok, rest} = Situ.AudioStream.Resampler.flush_filter(filter)
      iex> Situ.AudioBuffer.frame_count(first) + Situ.AudioBuffer.frame_count(rest)
      1600
  """
  @spec new(AudioFormat.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def new(%AudioFormat{} = format, opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, format} <- AudioFormat.validate(format),
         work = %{format | sample: work_sample_type(format.sample)},
         job =
           {:new_resampler, format.rate, opts[:rate], format.channels, work.sample,
            opts[:quality]},
         {:ok, native} <- NativeKernel.run_audio(job, 200) do
      {:ok,
       %__MODULE__{native: native, from: format, work: work, to: %{format | rate: opts[:rate]}}}
    end
  end

  # Sample types that libsoxr does not support are converted to the next larger one.
  defp work_sample_type(:u8), do: :s16
  defp work_sample_type(:s24), do: :s32
  defp work_sample_type(sample), do: sample

  @doc "Feeds a buffer in the filter's format and returns the audio that is ready, which may be empty."
  @spec feed_buffer(t(), AudioBuffer.t()) :: AudioBuffer.result()
  def feed_buffer(%__MODULE__{from: from} = filter, %AudioBuffer{format: from} = buffer),
    do: run_filter(filter, buffer, false)

  @doc "Returns the audio left inside the filter, which cannot be used after this."
  @spec flush_filter(t()) :: AudioBuffer.result()
  def flush_filter(%__MODULE__{} = filter),
    do: run_filter(filter, %AudioBuffer{format: filter.from, data: ""}, true)

  defp run_filter(filter, buffer, last?) do
    cost = estimate_cost(filter, buffer, last?)

    with {:ok, inside} <- Channels.reformat(buffer, sample: filter.work.sample),
         {:ok, data} <-
           NativeKernel.run_audio({:resample, filter.native, inside.data, last?}, cost) do
      out = %AudioBuffer{format: %{filter.work | rate: filter.to.rate}, data: data}
      Channels.reformat(out, sample: filter.to.sample)
    end
  end

  # 10 s of 48 kHz take 1.6 ms, which is 3 ns per sample of the higher rate. Flushing pushes the rest through the
  # filter, whose length grows with the ratio of the rates.
  defp estimate_cost(%{from: from, to: to}, buffer, last?) do
    pushed = if last?, do: 20 * from.channels * max(from.rate / to.rate, 1), else: 5
    Channels.estimate_cost(buffer) * max(to.rate / from.rate, 1) + pushed
  end

  @doc "Resamples a complete buffer in one call (`Situ.AudioOps.resample/3`)."
  @spec resample_buffer(AudioBuffer.t(), pos_integer(), keyword()) :: AudioBuffer.result()
  def resample_buffer(%AudioBuffer{format: %{rate: rate}} = buffer, rate, _opts),
    do: AudioBuffer.validate(buffer)

  def resample_buffer(%AudioBuffer{} = buffer, rate, opts) do
    with {:ok, filter} <- new(buffer.format, [rate: rate] ++ opts),
         {:ok, out} <- run_filter(filter, buffer, true),
         do: {:ok, out}
  end

  # The component

  @impl true
  def init(opts), do: {:ok, %{opts: opts, filter: nil, taken: 0, given: 0, seen: nil, last: nil}}

  @impl true
  def handle_message(:in, %{data: buffer, originating_time: time}, _context, state) do
    {flushed, state} = ensure_filter(state, buffer.format)

    if state.filter == :same do
      {flushed ++ [{:out, time, buffer}], %{state | last: time}}
    else
      out = Error.unwrap!(feed_buffer(state.filter, buffer))
      state = %{state | taken: state.taken + AudioBuffer.frame_count(buffer), seen: time}
      {actions, state} = emit_output(state, out)
      {flushed ++ actions, state}
    end
  end

  @impl true
  def handle_closed(:in, _time, _context, state), do: drain_filter(state)

  # Starts a filter for the format after draining the old one.
  defp ensure_filter(%{filter: %{from: format}} = state, format), do: {[], state}

  defp ensure_filter(%{opts: opts} = state, format) do
    {actions, state} = drain_filter(state)

    if format.rate == opts[:rate] do
      {actions, %{state | filter: :same}}
    else
      {actions, %{state | filter: Error.unwrap!(new(format, opts)), taken: 0, given: 0}}
    end
  end

  defp drain_filter(%{filter: %__MODULE__{} = filter} = state) do
    {actions, state} = emit_output(state, Error.unwrap!(flush_filter(filter)))
    {actions, %{state | filter: nil}}
  end

  defp drain_filter(state), do: {[], %{state | filter: nil}}

  defp emit_output(state, %AudioBuffer{data: ""}), do: {[], state}

  defp emit_output(%{filter: filter} = state, out) do
    given = state.given + AudioBuffer.frame_count(out)

    inside =
      AudioFormat.frames_to_ns(filter.from, state.taken) -
        AudioFormat.frames_to_ns(filter.to, given)

    time = state.seen - inside
    time = if state.last, do: max(time, state.last + 1), else: time
    {[{:out, time, out}], %{state | given: given, last: time}}
  end
end
