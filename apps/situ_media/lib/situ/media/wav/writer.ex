defmodule Situ.Media.Wav.Writer do
  @moduledoc false
  # Writes a WAV file buffer by buffer. The header is valid from the start (readers take the audio
  # up to the end of the file), so audio written before a crash is readable. `finish_file/1`
  # stores the final lengths. Beyond 4 GB the file becomes RF64.
  alias Situ.{AudioBuffer, AudioFormat, Error}
  alias Situ.Media.Wav.Format

  @enforce_keys [:file, :format, :path, :header]
  defstruct [:file, :format, :path, :header, bytes: 0]

  @type t :: %__MODULE__{}

  # Reserves space for the ds64 chunk, so that a file can grow into RF64.
  @ds64 28
  @limit 0xFFFFFFFF

  @doc "Creates the file. `start_time:` (ns) is stored in it as its creation date."
  @spec open(Path.t(), AudioFormat.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def open(path, %AudioFormat{} = format, opts \\ []) do
    header = %{fmt: Format.encode_chunk(format), info: info_chunk(opts[:start_time])}

    with {:ok, file} <- :file.open(path, [:write, :raw, :binary]),
         :ok <- :file.write(file, build_header(header, :unknown)) do
      {:ok, %__MODULE__{file: file, format: format, path: path, header: header}}
    else
      {:error, reason} -> {:error, write_error(path, reason)}
    end
  end

  @doc "Appends audio in the writer's format."
  @spec append_buffer(t(), AudioBuffer.t()) :: {:ok, t()} | {:error, Error.t()}
  def append_buffer(%__MODULE__{format: format} = writer, %AudioBuffer{format: format} = buffer) do
    case :file.write(writer.file, buffer.data) do
      :ok -> {:ok, %{writer | bytes: writer.bytes + byte_size(buffer.data)}}
      {:error, reason} -> {:error, write_error(writer.path, reason)}
    end
  end

  def append_buffer(%__MODULE__{} = writer, %AudioBuffer{} = buffer) do
    {:error,
     Error.new(:bad_audio, "#{Path.basename(writer.path)} contains #{inspect(writer.format)}",
       why: "a WAV file has a single format; this buffer has #{inspect(buffer.format)}",
       fix: "reformat or resample the stream before writing it"
     )}
  end

  @doc "Writes the lengths and closes the file."
  @spec finish_file(t()) :: :ok | {:error, Error.t()}
  def finish_file(%__MODULE__{} = writer) do
    pad = if rem(writer.bytes, 2) == 1, do: <<0>>, else: <<>>

    with :ok <- :file.write(writer.file, pad),
         :ok <- :file.pwrite(writer.file, 0, build_header(writer.header, writer.bytes)),
         :ok <- :file.close(writer.file) do
      :ok
    else
      {:error, reason} -> {:error, write_error(writer.path, reason)}
    end
  end

  defp build_header(parts, bytes) do
    body = IO.iodata_to_binary([build_chunk("fmt ", parts.fmt), parts.info])
    # Counts "WAVE", the reserved chunk, the other chunks, and the header of the data chunk.
    rest = 4 + 8 + @ds64 + byte_size(body) + 8

    case bytes do
      :unknown ->
        ["RIFF", <<@limit::little-32>>, "WAVE", junk_chunk(), body, "data", <<@limit::little-32>>]

      bytes when is_integer(bytes) and bytes + rest + 1 < @limit ->
        size = rest + bytes + rem(bytes, 2)
        ["RIFF", <<size::little-32>>, "WAVE", junk_chunk(), body, "data", <<bytes::little-32>>]

      bytes ->
        size = rest + bytes + rem(bytes, 2)

        ds64 =
          build_chunk("ds64", <<size::little-64, bytes::little-64, 0::little-64, 0::little-32>>)

        ["RF64", <<@limit::little-32>>, "WAVE", ds64, body, "data", <<@limit::little-32>>]
    end
  end

  defp junk_chunk, do: build_chunk("JUNK", <<0::size(@ds64 * 8)>>)

  defp info_chunk(nil), do: <<>>

  defp info_chunk(time) when is_integer(time) do
    date = Situ.Time.to_iso8601(time) <> <<0>>
    build_chunk("LIST", ["INFO", build_chunk("ICRD", date)])
  end

  defp build_chunk(id, body) do
    body = IO.iodata_to_binary(body)
    pad = if rem(byte_size(body), 2) == 1, do: <<0>>, else: <<>>
    IO.iodata_to_binary([id, <<byte_size(body)::little-32>>, body, pad])
  end

  defp write_error(path, reason) do
    Error.new(:cannot_write, "cannot write #{inspect(path)}: #{:file.format_error(reason)}",
      fix: "check that the folder exists and the disk is not full"
    )
  end
end
