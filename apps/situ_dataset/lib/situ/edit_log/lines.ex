defmodule Situ.EditLog.Lines do
  @moduledoc false
  # The lines of a log: a checksum (CRC-32, 8 hexadecimal digits), a space, and a JSON object. A crash can leave a last
  # line that is incomplete or has a wrong checksum. It was never acknowledged. Any other broken line is damage.
  alias Situ.EditLog.Entry

  @doc """
  Encodes a line: a map, or `{pairs}` to keep their order.

      iex> Situ.EditLog.Lines.encode(%{"n" => 1}) |> IO.iodata_to_binary()
      "d44b3b7e {\\"n\\":1}\\n"
  """
  @spec encode(map() | {[{String.t(), term()}]}) :: iodata()
  def encode(json) do
    text = Situ.JSON.encode(json)
    [checksum(text), " ", text, "\n"]
  end

  defp checksum(text),
    do:
      text
      |> :erlang.crc32()
      |> Integer.to_string(16)
      |> String.downcase()
      |> String.pad_leading(8, "0")

  defp decode(<<sum::binary-size(8), " ", text::binary>>) do
    with true <- checksum(text) == sum, {:ok, %{} = json} <- Situ.JSON.decode(text) do
      {:ok, json}
    else
      _ -> :error
    end
  end

  defp decode(_line), do: :error

  @doc "Returns the first object and its size in bytes; `:incomplete` if there is only a part of a line."
  @spec parse_first(binary()) :: {:ok, map(), non_neg_integer()} | :incomplete | :error
  def parse_first(bytes) do
    case :binary.split(bytes, "\n") do
      [line, _rest] ->
        with {:ok, json} <- decode(line), do: {:ok, json, byte_size(line) + 1}

      [_] ->
        :incomplete
    end
  end

  @doc "Returns whether the text begins with the entry of this number."
  @spec numbered?(binary(), pos_integer()) :: boolean()
  def numbered?(text, n), do: text =~ ~r/\A[0-9a-f]{8} \{"n":#{n}[,}]/

  @doc "Returns the entries, whose numbers begin with `n`, and their size in bytes; or the offset of damage."
  @spec parse_entries(binary(), pos_integer()) ::
          {:ok, [Entry.t()], non_neg_integer()} | {:damaged, non_neg_integer()}
  def parse_entries(bytes, n),
    do: bytes |> :binary.split("\n", [:global]) |> parse_lines(n, 0, [])

  # The text after the last line feed is incomplete.
  defp parse_lines([_incomplete], _n, size, done), do: {:ok, Enum.reverse(done), size}

  defp parse_lines([line | rest], n, size, done) do
    with {:ok, json} <- decode(line), {:ok, %{n: ^n} = entry} <- Entry.parse(json) do
      parse_lines(rest, n + 1, size + byte_size(line) + 1, [entry | done])
    else
      # A power failure can leave the line feed of a line without its content.
      :error when rest == [""] -> {:ok, Enum.reverse(done), size}
      _ -> {:damaged, size}
    end
  end

  @doc "Returns the entries of all valid lines."
  @spec parse_valid(binary()) :: [Entry.t()]
  def parse_valid(bytes) do
    for line <- :binary.split(bytes, "\n", [:global]),
        {:ok, json} <- [decode(line)],
        {:ok, entry} <- [Entry.parse(json)],
        do: entry
  end
end
