defmodule Situ.Media.Wav.Reader do
  @moduledoc false
  # Reads a WAV file in buffers, starting at any time. The time of a buffer is its end, counted in samples from the
  # start of the file, so it is exact to the sample at any rate.
  alias Situ.{AudioBuffer, AudioFormat, Error}
  alias Situ.Media.Wav.Format

  @schema [
    buffer: [type: :pos_integer, default: 20_000_000, doc: "Length of a buffer, ns."],
    start: [type: :non_neg_integer, default: 0, doc: "Start, ns from the start of the file."],
    end: [type: {:optional, :pos_integer}, default: nil, doc: "End, ns; `nil`: end of the file."]
  ]

  @enforce_keys [:file, :format, :name]
  defstruct [
    :file,
    :format,
    :name,
    :recorded_at,
    :claimed,
    data: 0,
    bytes: 0,
    frame: 0,
    last: 0,
    step: 1,
    cut?: false
  ]

  @type t :: %__MODULE__{}

  # A file with more chunks before its audio is treated as an attack.
  @max_chunks 256
  @max_text 4096

  @doc """
  Opens the file and reads its header.

  #{Situ.Options.docs(@schema)}
  """
  @spec open(Path.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def open(path, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, file} <- open_file(path) do
      case read_header(file, Path.basename(path)) do
        {:ok, reader} ->
          {:ok, apply_span(reader, opts)}

        {:error, error} ->
          :file.close(file)
          {:error, error}
      end
    end
  end

  @doc "Returns the length of the audio, ns."
  @spec total_duration(t()) :: Situ.Time.duration()
  def total_duration(%__MODULE__{} = reader),
    do: AudioFormat.frames_to_ns(reader.format, total_frames(reader))

  @doc "Returns the number of frames in the file."
  @spec frame_count(t()) :: non_neg_integer()
  def frame_count(%__MODULE__{} = reader), do: total_frames(reader)

  @doc "Returns the number of audio bytes that the header states but the file does not contain."
  @spec missing_bytes(t()) :: non_neg_integer()
  def missing_bytes(%__MODULE__{} = reader), do: reader.claimed - reader.bytes

  @doc "Reopens the file in the calling process and keeps the parsed header."
  @spec reopen_file(t(), Path.t()) :: {:ok, t()} | {:error, Error.t()}
  def reopen_file(%__MODULE__{} = reader, path) do
    with {:ok, file} <- open_file(path), do: {:ok, %{reader | file: file}}
  end

  @doc "Reads `count` frames from frame `first`. Returns an error if the file has become shorter."
  @spec read_slice(t(), non_neg_integer(), non_neg_integer()) :: AudioBuffer.result()
  def read_slice(%__MODULE__{format: format} = reader, first, count) do
    size = AudioFormat.bytes_per_frame(format)

    case :file.pread(reader.file, reader.data + first * size, count * size) do
      {:ok, data} when byte_size(data) == count * size ->
        {:ok, %AudioBuffer{format: format, data: data}}

      {:error, reason} ->
        {:error, unreadable_error(reader.name, :file.format_error(reason))}

      _ ->
        {:error, truncated_error(reader)}
    end
  end

  @doc """
  Reads the next buffer. After the last complete frame it returns `:eof`, or an error if the file is shorter than its
  header states.
  """
  @spec next_buffer(t()) ::
          {:ok, Situ.Time.t(), AudioBuffer.t(), t()} | :eof | {:error, Error.t()}
  def next_buffer(%__MODULE__{frame: frame, last: last} = reader) when frame < last do
    size = AudioFormat.bytes_per_frame(reader.format)
    want = min(reader.step, last - frame)

    case :file.pread(reader.file, reader.data + frame * size, want * size) do
      {:ok, bytes} ->
        read = div(byte_size(bytes), size)
        # Reads nothing if the file was shortened after it was opened.
        if read == 0,
          do: {:error, truncated_error(reader)},
          else: build_buffer(bytes, read, size, reader)

      :eof ->
        {:error, truncated_error(reader)}

      {:error, reason} ->
        {:error, unreadable_error(reader.name, :file.format_error(reason))}
    end
  end

  def next_buffer(%__MODULE__{cut?: true} = reader), do: {:error, truncated_error(reader)}
  def next_buffer(%__MODULE__{}), do: :eof

  @doc "Closes the file."
  @spec close_file(t()) :: :ok
  def close_file(%__MODULE__{file: file}) do
    _ = :file.close(file)
    :ok
  end

  defp build_buffer(bytes, read, size, reader) do
    frame = reader.frame + read
    data = if read * size == byte_size(bytes), do: bytes, else: binary_part(bytes, 0, read * size)
    buffer = %AudioBuffer{format: reader.format, data: data}
    {:ok, AudioFormat.frames_to_ns(reader.format, frame), buffer, %{reader | frame: frame}}
  end

  defp apply_span(reader, opts) do
    total = total_frames(reader)
    limit = if opts[:end], do: AudioFormat.ns_to_frames(reader.format, opts[:end]), else: total

    %{
      reader
      | frame: min(AudioFormat.ns_to_frames(reader.format, opts[:start]), total),
        last: min(limit, total),
        step: max(AudioFormat.ns_to_frames(reader.format, opts[:buffer]), 1),
        cut?: reader.cut? and limit >= total
    }
  end

  defp total_frames(reader), do: div(reader.bytes, AudioFormat.bytes_per_frame(reader.format))

  defp open_file(path) do
    # Rejects FIFOs, for which `open` would wait for a writer, and devices, which never end.
    with {:ok, %{type: :regular}} <- File.stat(path),
         {:ok, file} <- :file.open(path, [:read, :raw, :binary]) do
      {:ok, file}
    else
      {:ok, %{type: type}} -> {:error, unreadable_error(path, "the path is a #{type}")}
      {:error, reason} -> {:error, no_file(path, reason)}
    end
  end

  defp read_header(file, name) do
    case :file.pread(file, 0, 12) do
      {:ok, <<riff::binary-size(4), _size::32, "WAVE">>} when riff in ["RIFF", "RF64", "BW64"] ->
        read_chunks(file, 12, @max_chunks, %{
          name: name,
          format: nil,
          size64: nil,
          recorded_at: nil
        })

      {:ok, _} ->
        {:error, unreadable_error(name, "the file does not begin with a WAV header")}

      :eof ->
        {:error, unreadable_error(name, "the file is empty")}

      {:error, reason} ->
        {:error, unreadable_error(name, :file.format_error(reason))}
    end
  end

  defp read_chunks(_file, _at, 0, %{name: name}),
    do:
      {:error,
       unreadable_error(name, "the file has more than #{@max_chunks} chunks before its audio")}

  defp read_chunks(file, at, left, seen) do
    case :file.pread(file, at, 8) do
      {:ok, <<"data", size::little-32>>} ->
        read_data_chunk(file, at + 8, size, seen)

      {:ok, <<id::binary-size(4), size::little-32>>} ->
        with {:ok, seen} <- read_chunk(id, size, file, at + 8, seen) do
          # Chunks begin at even offsets.
          read_chunks(file, at + 8 + size + rem(size, 2), left - 1, seen)
        end

      _ ->
        {:error, unreadable_error(seen.name, "the file ends before its audio begins")}
    end
  end

  defp read_chunk("fmt ", size, file, at, seen) do
    with {:ok, bytes} <- :file.pread(file, at, min(size, 40)),
         {:ok, format} <- Format.parse_chunk(bytes) do
      {:ok, %{seen | format: format}}
    else
      {:error, %Error{} = error} -> {:error, %{error | what: "cannot read #{seen.name}"}}
      _ -> {:error, unreadable_error(seen.name, "the fmt chunk is truncated")}
    end
  end

  defp read_chunk("ds64", size, file, at, seen) when size >= 24 do
    case :file.pread(file, at, 24) do
      {:ok, <<_riff::little-64, data::little-64, _samples::little-64>>} ->
        {:ok, %{seen | size64: data}}

      _ ->
        {:ok, seen}
    end
  end

  # LIST INFO contains the recording time as ICRD.
  defp read_chunk("LIST", size, file, at, seen) when size >= 12 and size <= @max_text do
    case :file.pread(file, at, size) do
      {:ok, <<"INFO", items::binary>>} ->
        {:ok, %{seen | recorded_at: recorded_at(items) || seen.recorded_at}}

      _ ->
        {:ok, seen}
    end
  end

  defp read_chunk(_id, _size, _file, _at, seen), do: {:ok, seen}

  defp recorded_at(<<"ICRD", size::little-32, text::binary-size(size), _::binary>>) do
    case text |> String.trim_trailing(<<0>>) |> Situ.Time.parse() do
      {:ok, time} -> time
      {:error, _} -> nil
    end
  end

  defp recorded_at(<<_id::binary-size(4), size::little-32, rest::binary>>) do
    skip = size + rem(size, 2)

    if skip <= byte_size(rest), do: recorded_at(binary_part(rest, skip, byte_size(rest) - skip))
  end

  defp recorded_at(_), do: nil

  defp read_data_chunk(_file, _at, _size, %{format: nil, name: name}),
    do: {:error, unreadable_error(name, "the audio comes before the fmt chunk")}

  defp read_data_chunk(file, at, size, seen) do
    {:ok, file_size} = :file.position(file, :eof)
    there = max(file_size - at, 0)

    # 0 or all ones means that the writer did not know the length, so the audio extends to the end of the file.
    claimed =
      case {seen.size64, size} do
        {nil, unknown} when unknown in [0, 0xFFFFFFFF] -> there
        {size64, 0xFFFFFFFF} when size64 not in [nil, 0] -> size64
        {_, 0xFFFFFFFF} -> there
        {_, size} -> size
      end

    {:ok,
     %__MODULE__{
       file: file,
       name: seen.name,
       format: seen.format,
       recorded_at: seen.recorded_at,
       data: at,
       bytes: min(claimed, there),
       claimed: claimed,
       cut?: claimed > there
     }}
  end

  defp truncated_error(reader) do
    missing = reader.claimed - reader.bytes

    Error.new(:damaged_media, "#{reader.name} is truncated",
      why:
        "the header states #{reader.claimed} bytes of audio, but #{missing} of them are missing",
      meta: %{read_ns: AudioFormat.frames_to_ns(reader.format, reader.frame)}
    )
  end

  defp unreadable_error(name, why),
    do: Error.new(:unreadable_media, "cannot read #{Path.basename(name)}", why: to_string(why))

  defp no_file(path, reason) do
    Error.new(:no_file, "cannot open #{inspect(path)}: #{:file.format_error(reason)}",
      fix: "check the path; relative paths start at #{File.cwd!()}"
    )
  end
end
