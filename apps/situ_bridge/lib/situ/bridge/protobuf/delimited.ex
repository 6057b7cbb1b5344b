defmodule Situ.Bridge.Protobuf.Delimited do
  @moduledoc false
  # A sequence of messages, each preceded by its length as a varint.
  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.Bridge.Protobuf.Writer
  alias Situ.Error

  @chunk 65_536
  @max_message 64 * 1024 * 1024

  @doc """
  Prefixes a message with its length.

      iex> Situ.Bridge.Protobuf.Delimited.encode_frame(<<1, 2>>) |> IO.iodata_to_binary()
      <<2, 1, 2>>
  """
  @spec encode_frame(iodata()) :: iodata()
  def encode_frame(bytes), do: [bytes |> IO.iodata_length() |> Writer.encode_varint(), bytes]

  @doc "Streams the bytes of each message with their offset; raises `Situ.Error` (`:io`, `:bad_file`)."
  @spec stream_payloads(Path.t()) :: Enumerable.t()
  def stream_payloads(path) do
    Stream.resource(
      fn ->
        case :file.open(path, [:read, :raw, :binary, :read_ahead]) do
          {:ok, file} -> {file, "", 0}
          {:error, reason} -> raise io_error(path, reason)
        end
      end,
      &read_chunk(&1, path),
      fn {file, _, _} -> :file.close(file) end
    )
  end

  defp read_chunk({file, bytes, at}, path) do
    case :file.read(file, @chunk) do
      {:ok, chunk} ->
        case split_payloads(bytes <> chunk, at, []) do
          {:ok, payloads, rest, at} ->
            {payloads, {file, rest, at}}

          {:error, [], at, why} ->
            raise bad_file_error(path, at, why)

          # The messages before the invalid one are returned first.
          {:error, payloads, at, _why} ->
            {payloads, {file, remaining_bytes(bytes <> chunk, payloads, at), at}}
        end

      :eof when bytes == "" ->
        {:halt, {file, bytes, at}}

      :eof ->
        raise_truncated(bytes, at, path)

      {:error, reason} ->
        raise io_error(path, reason)
    end
  end

  defp raise_truncated(bytes, at, path) do
    case split_payloads(bytes, at, []) do
      {:error, _, at, why} -> raise bad_file_error(path, at, why)
      _ -> raise bad_file_error(path, at, "the file ends within a message")
    end
  end

  # The bytes from the invalid message on.
  defp remaining_bytes(bytes, [{first, _} | _], at),
    do: binary_part(bytes, at - first, byte_size(bytes) - at + first)

  defp split_payloads(bytes, at, payloads) do
    case parse_length(bytes, 0, 0) do
      {n, _, _} when n > @max_message ->
        {:error, Enum.reverse(payloads), at, "a message of #{n} bytes exceeds the limit"}

      {n, length_size, rest} when byte_size(rest) >= n ->
        <<payload::binary-pinned_size(n), rest::binary>> = rest
        split_payloads(rest, at + length_size + n, [{at, payload} | payloads])

      :wrong ->
        {:error, Enum.reverse(payloads), at, "the length of a message is invalid"}

      _more ->
        {:ok, Enum.reverse(payloads), bytes, at}
    end
  end

  defp parse_length(_bytes, 5, _sum), do: :wrong

  defp parse_length(<<0::1, n::7, rest::binary>>, length_size, sum),
    do: {sum + Bitwise.bsl(n, 7 * length_size), length_size + 1, rest}

  defp parse_length(<<1::1, n::7, rest::binary>>, length_size, sum),
    do: parse_length(rest, length_size + 1, sum + Bitwise.bsl(n, 7 * length_size))

  defp parse_length("", _used, _sum), do: :more

  @spec io_error(Path.t(), atom()) :: Error.t()
  def io_error(path, reason),
    do: Error.new(:io, "cannot access #{path}", why: to_string(:file.format_error(reason)))

  @spec bad_file_error(Path.t(), non_neg_integer(), String.t()) :: Error.t()
  def bad_file_error(path, at, why) do
    Error.new(:bad_file, "cannot read #{path}",
      why: "#{why} (at byte #{at})",
      fix: "check that all messages have this type, and that each is preceded by its length"
    )
  end
end
