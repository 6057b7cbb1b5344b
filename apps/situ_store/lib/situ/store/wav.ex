defmodule Situ.Store.Wav do
  @moduledoc """
  WAV files as recordings: one stream `Audio` of 20 ms buffers.

  Originating times are the ends of the buffers; the file starts at time 0, or at the option `start:` (ns). Data are audio buffers
  when the application that knows the codec `situ.audio_buffer` is there, else maps of the same shape:
  `%{format: %{rate: 48_000, channels: 2, sample: :s16}, data: bytes}`.
  PCM of 8, 16, 24 and 32 bits and float of 32 and 64 bits. A file cut short is read as far as it goes.
  """
  @behaviour Situ.Store.Reader
  alias Situ.{Error, Message}
  alias Situ.Store.{Codecs, StreamInfo, TypeName}

  @codec "situ.audio_buffer"
  @ns 1_000_000_000
  @samples %{
    {1, 8} => :u8,
    {1, 16} => :s16,
    {1, 24} => :s24,
    {1, 32} => :s32,
    {3, 32} => :f32,
    {3, 64} => :f64
  }
  @codes %{u8: 1, s16: 2, s24: 3, s32: 4, f32: 5, f64: 6}

  defstruct [
    :path,
    :rate,
    :channels,
    :sample,
    :offset,
    :frames,
    :frame_size,
    :step,
    :start,
    :codec
  ]

  @impl true
  def extensions, do: [".wav"]

  @impl true
  def open(path, opts) do
    with {:ok, file} <- File.open(path, [:read, :raw, :binary]),
         {:ok, %{size: size}} <- File.stat(path),
         result = header(file, size),
         :ok <- File.close(file),
         {:ok, {tag, channels, rate, bits}, offset, bytes} <- result,
         {:ok, sample} <- Map.fetch(@samples, {tag, bits}) do
      frame = channels * div(bits, 8)

      {:ok,
       %__MODULE__{
         path: path,
         rate: rate,
         channels: channels,
         sample: sample,
         offset: offset,
         frames: div(bytes, frame),
         frame_size: frame,
         step: max(div(rate, 50), 1),
         start: opts[:start] || 0,
         codec: Codecs.find(@codec, nil)
       }}
    else
      {:error, reason} when is_atom(reason) ->
        {:error,
         Error.new(:io, "cannot read #{path}", why: to_string(:file.format_error(reason)))}

      {:error, why} ->
        {:error, bad(path, why)}

      :error ->
        {:error, bad(path, "its sample format is none of PCM 8, 16, 24, 32 or float 32, 64")}
    end
  end

  defp bad(path, why),
    do: Error.new(:not_wav, "#{path} is not a WAV file Situ can read", why: why)

  defp header(file, size) do
    case :file.pread(file, 0, 12) do
      {:ok, <<"RIFF", _::little-32, "WAVE">>} -> chunks(file, 12, size, nil)
      {:ok, _} -> {:error, "it does not begin with RIFF and WAVE"}
      :eof -> {:error, "it is empty"}
      {:error, reason} -> {:error, reason}
    end
  end

  defp chunks(file, at, size, format) do
    case {:file.pread(file, at, 8), format} do
      {{:ok, <<"fmt ", n::little-32>>}, _} when n >= 16 and n < 4096 ->
        with {:ok, format} <- format(file, at + 8, n), do: chunks(file, next(at, n), size, format)

      {{:ok, <<"data", n::little-32>>}, format} when format != nil ->
        {:ok, format, at + 8, min(n, size - at - 8)}

      {{:ok, <<_::binary-4, n::little-32>>}, _} ->
        chunks(file, next(at, n), size, format)

      _ ->
        {:error, "it ends before its sound data"}
    end
  end

  # Chunks are padded to even lengths.
  defp next(at, n), do: at + 8 + n + rem(n, 2)

  defp format(file, at, n) do
    case :file.pread(file, at, n) do
      {:ok,
       <<0xFFFE::little-16, channels::little-16, rate::little-32, _::binary-6, bits::little-16,
         _::binary-8, tag::little-16, _::binary>>}
      when channels > 0 and rate > 0 ->
        {:ok, {tag, channels, rate, bits}}

      {:ok,
       <<tag::little-16, channels::little-16, rate::little-32, _::binary-6, bits::little-16,
         _::binary>>}
      when channels > 0 and rate > 0 and bits > 0 ->
        {:ok, {tag, channels, rate, bits}}

      _ ->
        {:error, "its format chunk is damaged"}
    end
  end

  @impl true
  def info(state) do
    name = Path.basename(state.path, Path.extname(state.path))
    %{name: name, created: nil, closed?: true, live?: false, damage: []}
  end

  @impl true
  def streams(state) do
    count = count(state)
    size = state.frames * state.frame_size

    type = if state.codec, do: state.codec, else: :map

    [
      %StreamInfo{
        id: 1,
        name: "Audio",
        store_name: info(state).name,
        store_path: state.path,
        type: type,
        type_name: TypeName.write(type),
        count: count,
        size: size,
        stored: size,
        opened: state.start,
        closed: time(state, max(count - 1, 0)),
        first: if(count > 0, do: time(state, 0)),
        last: if(count > 0, do: time(state, count - 1)),
        first_creation: if(count > 0, do: time(state, 0)),
        last_creation: if(count > 0, do: time(state, count - 1))
      }
    ]
  end

  defp count(state), do: div(state.frames + state.step - 1, state.step)
  defp time(state, ordinal), do: state.start + div(end_frame(state, ordinal) * @ns, state.rate)
  defp end_frame(state, ordinal), do: min((ordinal + 1) * state.step, state.frames)

  @impl true
  def seek(state, _info, time) do
    # The first buffer whose end is at or after `time`; rounding can put it one off either way.
    guess = div(max(time - state.start, 0) * state.rate, @ns * state.step)
    last = count(state)

    first =
      Enum.find(max(guess - 2, 0)..max(guess + 2, 0), &(&1 < last and time(state, &1) >= time))

    {:ok, first || last}
  end

  @impl true
  def read(state, info, ordinal, to, limit, _opts) do
    last = min(count(state), ordinal + min(limit, 500)) - 1

    ordinals =
      Enum.take_while(
        Enum.to_list(ordinal..last//1),
        &(to == :unbounded or time(state, &1) <= to)
      )

    case ordinals do
      [] -> {:ok, [], ordinal}
      _ -> load(state, info, ordinals)
    end
  end

  defp load(state, info, [first | _] = ordinals) do
    from = first * state.step
    bytes = (end_frame(state, List.last(ordinals)) - from) * state.frame_size

    with {:ok, file} <- :file.open(state.path, [:read, :raw, :binary]),
         {:ok, data} <- :file.pread(file, state.offset + from * state.frame_size, bytes),
         :ok <- :file.close(file),
         true <- byte_size(data) == bytes do
      messages =
        for ordinal <- ordinals do
          at = (ordinal * state.step - from) * state.frame_size
          n = (end_frame(state, ordinal) - ordinal * state.step) * state.frame_size
          time = time(state, ordinal)

          %Message{
            data: buffer(state, binary_part(data, at, n)),
            originating_time: time,
            creation_time: time,
            sequence_id: ordinal + 1,
            source_id: info.id
          }
        end

      {:ok, messages, List.last(ordinals) + 1}
    else
      _ -> {:error, Error.new(:damaged, "#{state.path} has changed since it was opened")}
    end
  end

  defp buffer(%{codec: nil} = state, data),
    do: %{
      format: %{rate: state.rate, channels: state.channels, sample: state.sample},
      data: data
    }

  defp buffer(state, data) do
    {:ok, buffer} = state.codec.decode(encoded(state, data))
    buffer
  end

  # The layout that codec has written since its first version.
  defp encoded(state, data) do
    <<1, Map.fetch!(@codes, state.sample), state.channels::little-16, state.rate::little-32,
      0::64, data::binary>>
  end
end
