defmodule Situ.AudioOps.Channels do
  @moduledoc false
  # Converts channels, gain and sample types of a buffer. `Situ.AudioOps` documents the functions.
  #
  # All operations use one kernel: every output channel is a weighted sum of input channels,
  # rounded to the nearest value and clipped.
  alias Situ.{AudioBuffer, AudioFormat, Error}
  alias Situ.Media.NativeKernel

  def reformat(%AudioBuffer{format: format} = buffer, opts) do
    opts = Keyword.validate!(opts, channels: format.channels, sample: format.sample)

    with {:ok, gains} <- spread_gains(format.channels, opts[:channels]),
         do: remix(buffer, gains, sample: opts[:sample])
  end

  defp spread_gains(same, same), do: {:ok, identity_matrix(same)}
  defp spread_gains(1, to) when to in 1..1024, do: {:ok, List.duplicate([1.0], to)}
  defp spread_gains(from, 1), do: {:ok, [List.duplicate(1.0 / from, from)]}

  defp spread_gains(from, to) do
    {:error,
     Error.new(:bad_option, "cannot convert #{from} channels to #{inspect(to)} without a matrix",
       fix: "use remix/3 with a matrix of gains, or select_channels/2"
     )}
  end

  def remix(%AudioBuffer{} = buffer, matrix, opts \\ []) when is_list(matrix) do
    sample = Keyword.get(opts, :sample) || buffer.format.sample

    with {:ok, buffer} <- AudioBuffer.validate(buffer),
         to = %{buffer.format | channels: length(matrix), sample: sample},
         {:ok, to} <- AudioFormat.validate(to),
         :ok <- check_rows(matrix, buffer.format.channels) do
      if to == buffer.format and matrix == identity_matrix(to.channels) do
        {:ok, buffer}
      else
        gains = matrix |> List.flatten() |> Enum.map(&(&1 * 1.0))
        job = {:mix, buffer.data, native_layout(buffer.format), native_layout(to), gains}

        with {:ok, data} <- NativeKernel.run_audio(job, estimate_cost(buffer)),
             do: {:ok, %AudioBuffer{format: to, data: data}}
      end
    end
  end

  defp check_rows(matrix, channels) do
    if Enum.all?(matrix, &(is_list(&1) and length(&1) == channels)) do
      :ok
    else
      {:error,
       Error.new(:bad_option, "each row of the matrix needs #{channels} gains, one per channel")}
    end
  end

  def select_channels(%AudioBuffer{format: format} = buffer, channels) do
    case Enum.find(channels, &(&1 not in 0..(format.channels - 1))) do
      nil ->
        matrix = for c <- channels, do: for(i <- 0..(format.channels - 1), do: one_if(i == c))
        remix(buffer, matrix)

      missing ->
        what = "unknown channel #{inspect(missing)}: the buffer has #{format.channels} channels"
        {:error, Error.new(:bad_option, what, fix: "channels are counted from 0")}
    end
  end

  def gain(buffer, {:db, db}), do: gain(buffer, :math.pow(10, db / 20))

  def gain(%AudioBuffer{format: format} = buffer, factor) when is_number(factor) do
    matrix =
      for o <- 1..format.channels,
          do: for(i <- 1..format.channels, do: if(i == o, do: factor * 1.0, else: 0.0))

    remix(buffer, matrix)
  end

  def mix(a, b, opts \\ [])

  def mix(%AudioBuffer{format: format} = a, %AudioBuffer{format: format} = b, opts) do
    with {:ok, a} <- AudioBuffer.validate(a),
         {:ok, b} <- AudioBuffer.validate(b),
         job = {:add, a.data, b.data, native_layout(format), Keyword.get(opts, :gain, 1.0) * 1.0},
         {:ok, data} <- NativeKernel.run_audio(job, estimate_cost(a) + estimate_cost(b)) do
      {:ok, %AudioBuffer{format: format, data: data}}
    end
  end

  def mix(%AudioBuffer{} = a, %AudioBuffer{} = b, _opts) do
    what = "cannot mix #{inspect(a.format)} and #{inspect(b.format)}"
    {:error, Error.new(:bad_audio, what, fix: "reformat or resample one buffer first")}
  end

  def level(%AudioBuffer{} = buffer) do
    with {:ok, buffer} <- AudioBuffer.validate(buffer),
         {:ok, channels} <-
           NativeKernel.run_audio(
             {:levels, buffer.data, native_layout(buffer.format)},
             estimate_cost(buffer)
           )
           |> name_bad_samples(buffer, "levels"),
         do: {:ok, Situ.AudioStream.Level.new(channels)}
  end

  @doc false
  # A kernel cannot return NaN or infinity as a number, so this failure is caused by the samples.
  @spec name_bad_samples({:ok, term()} | {:error, Error.t()}, AudioBuffer.t(), String.t()) ::
          {:ok, term()} | {:error, Error.t()}
  def name_bad_samples({:error, %Error{code: :bad_option} = error}, buffer, operation) do
    case not_a_number(buffer.data, buffer.format.sample, 0) do
      nil ->
        {:error, error}

      sample ->
        {:error,
         Error.new(:bad_audio, "#{operation}: sample #{sample} is not a number",
           why: "the audio contains NaN or infinity, for example after a division by zero",
           fix: "fix the source of the audio; samples of #{buffer.format.sample} are -1.0 to 1.0"
         )}
    end
  end

  def name_bad_samples(result, _buffer, _operation), do: result

  # Returns the index of the first sample that does not match a float.
  defp not_a_number(<<_::float-little-32, rest::binary>>, :f32, n),
    do: not_a_number(rest, :f32, n + 1)

  defp not_a_number(<<_::float-little-64, rest::binary>>, :f64, n),
    do: not_a_number(rest, :f64, n + 1)

  defp not_a_number(<<_, _::binary>>, sample, n) when sample in [:f32, :f64], do: n
  defp not_a_number(_data, _sample, _n), do: nil

  def points(%AudioBuffer{format: format} = buffer, originating_time) do
    span = max(div(format.rate, 1000), 1)
    start = AudioBuffer.start_time(buffer, originating_time)

    with {:ok, points} <-
           NativeKernel.run_audio(
             {:points, buffer.data, native_layout(format), span},
             estimate_cost(buffer)
           ) do
      {:ok,
       for {{min, max, last, count}, i} <- Enum.with_index(points) do
         {start + AudioFormat.frames_to_ns(format, i * span), min, max, last, count}
       end}
    end
  end

  @doc false
  @spec native_layout(AudioFormat.t()) :: {AudioFormat.sample(), pos_integer()}
  def native_layout(%AudioFormat{} = format), do: {format.sample, format.channels}

  @doc false
  # Estimates about 3 ns per sample.
  @spec estimate_cost(AudioBuffer.t()) :: float()
  def estimate_cost(%AudioBuffer{} = buffer),
    do: byte_size(buffer.data) / AudioFormat.bytes_per_sample(buffer.format) * 0.003

  defp identity_matrix(n), do: for(o <- 1..n, do: for(i <- 1..n, do: one_if(i == o)))
  defp one_if(true), do: 1.0
  defp one_if(false), do: 0.0
end
