defmodule Situ.Bridge.Protobuf.Delimited do
  @moduledoc false
  # A sequence of messages, each preceded by its length as a varint.
  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.Bridge.Protobuf.Writer
  alias Situ.Error

  @chunk 65_536
  @most 64 * 1024 * 1024

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
      {:ok, more} ->
        case split_payloads(bytes <> more, at, []) do
          {:ok, found, rest, at} ->
            {found, {file, rest, at}}

          {:error, [], at, why} ->
            raise bad_file_error(path, at, why)

          # The messages before the invalid one are returned first.
          {:error, found, at, _why} ->
            {found, {file, remaining_bytes(bytes <> more, found, at), at}}
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

  defp split_payloads(bytes, at, found) do
    case parse_length(bytes, 0, 0) do
      {n, _, _} when n > @most ->
        {:error, Enum.reverse(found), at, "a message of #{n} bytes exceeds the limit"}

      {n, used, rest} when byte_size(rest) >= n ->
        <<payload::binary-pinned_size(n), rest::binary>> = rest
        split_payloads(rest, at + used + n, [{at, payload} | found])

      :wrong ->
        {:error, Enum.reverse(found), at, "the length of a message is invalid"}

      _more ->
        {:ok, Enum.reverse(found), bytes, at}
    end
  end

  defp parse_length(_bytes, 5, _sum), do: :wrong

  defp parse_length(<<0::1, n::7, rest::binary>>, used, sum),
    do: {sum + Bitwise.bsl(n, 7 * used), used + 1, rest}

  defp parse_length(<<1::1, n::7, rest::binary>>, used, sum),
    do: parse_length(rest, used + 1, sum + Bitwise.bsl(n, 7 * used))

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
