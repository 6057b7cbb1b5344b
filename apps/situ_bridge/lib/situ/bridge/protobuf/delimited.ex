defmodule Situ.Bridge.Protobuf.Delimited do
  @moduledoc false
  # A sequence of messages, each preceded by its length as a varint.
  import Situ.Bits, only: [known: 1]
  alias Situ.Bridge.Protobuf.Writer
  alias Situ.Error

  @chunk 65_536
  @most 64 * 1024 * 1024

  @doc """
  Prefixes a message with its length.

      iex> Situ.Bridge.Protobuf.Delimited.frame(<<1, 2>>) |> IO.iodata_to_binary()
      <<2, 1, 2>>
  """
  @spec frame(iodata()) :: iodata()
  def frame(bytes), do: [bytes |> IO.iodata_length() |> Writer.put_varint(), bytes]

  @doc "Streams the bytes of each message with their offset; raises `Situ.Error` (`:io`, `:bad_file`)."
  @spec payloads(Path.t()) :: Enumerable.t()
  def payloads(path) do
    Stream.resource(
      fn ->
        case :file.open(path, [:read, :raw, :binary, :read_ahead]) do
          {:ok, file} -> {file, "", 0}
          {:error, reason} -> raise io(path, reason)
        end
      end,
      &next(&1, path),
      fn {file, _, _} -> :file.close(file) end
    )
  end

  defp next({file, bytes, at}, path) do
    case :file.read(file, @chunk) do
      {:ok, more} ->
        case split(bytes <> more, at, []) do
          {:ok, found, rest, at} -> {found, {file, rest, at}}
          {:error, [], at, why} -> raise bad(path, at, why)
          # The messages before the invalid one are returned first.
          {:error, found, at, _why} -> {found, {file, rest(bytes <> more, found, at), at}}
        end

      :eof when bytes == "" ->
        {:halt, {file, bytes, at}}

      :eof ->
        ended(bytes, at, path)

      {:error, reason} ->
        raise io(path, reason)
    end
  end

  defp ended(bytes, at, path) do
    case split(bytes, at, []) do
      {:error, _, at, why} -> raise bad(path, at, why)
      _ -> raise bad(path, at, "the file ends within a message")
    end
  end

  # The bytes from the invalid message on.
  defp rest(bytes, [{first, _} | _], at),
    do: binary_part(bytes, at - first, byte_size(bytes) - at + first)

  defp split(bytes, at, found) do
    case length(bytes, 0, 0) do
      {n, _, _} when n > @most ->
        {:error, Enum.reverse(found), at, "a message of #{n} bytes exceeds the limit"}

      {n, used, rest} when byte_size(rest) >= n ->
        <<payload::binary-known(n), rest::binary>> = rest
        split(rest, at + used + n, [{at, payload} | found])

      :wrong ->
        {:error, Enum.reverse(found), at, "the length of a message is invalid"}

      _more ->
        {:ok, Enum.reverse(found), bytes, at}
    end
  end

  defp length(_bytes, 5, _sum), do: :wrong

  defp length(<<0::1, n::7, rest::binary>>, used, sum),
    do: {sum + Bitwise.bsl(n, 7 * used), used + 1, rest}

  defp length(<<1::1, n::7, rest::binary>>, used, sum),
    do: length(rest, used + 1, sum + Bitwise.bsl(n, 7 * used))

  defp length("", _used, _sum), do: :more

  @spec io(Path.t(), atom()) :: Error.t()
  def io(path, reason),
    do: Error.new(:io, "cannot access #{path}", why: to_string(:file.format_error(reason)))

  @spec bad(Path.t(), non_neg_integer(), String.t()) :: Error.t()
  def bad(path, at, why) do
    Error.new(:bad_file, "cannot read #{path}",
      why: "#{why} (at byte #{at})",
      fix: "check that all messages have this type, and that each is preceded by its length"
    )
  end
end
