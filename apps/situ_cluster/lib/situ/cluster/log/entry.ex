defmodule Situ.Cluster.Log.Entry do
  @moduledoc false
  # Represents one entry of a log. `op` identifies the write (unique), `head` is short text about
  # `data`, `seq` is its position on the subject (`nil` before it is written), and `verified` says
  # whether its author was checked.
  @magic "SITULOG1"

  @enforce_keys [:op]
  defstruct [:seq, :op, head: %{}, data: "", verified: false]

  @type t :: %__MODULE__{
          seq: pos_integer() | nil,
          op: String.t(),
          head: %{String.t() => String.t()},
          data: iodata(),
          verified: boolean()
        }

  @doc """
  Returns an integer field of the head, or `default`.

      iex> entry = %Situ.Cluster.Log.Entry{op: "a.1", head: %{"Last" => "17"}, data: "..."}
      iex> Situ.Cluster.Log.Entry.head_integer(entry, "Last", 0)
      17
      iex> bytes = entry |> Situ.Cluster.Log.Entry.encode() |> IO.iodata_to_binary()
      iex> Situ.Cluster.Log.Entry.decode(bytes, 5)
      {:ok, %Situ.Cluster.Log.Entry{op: "a.1", head: %{"Last" => "17"}, data: "...", seq: 5}}
      iex> Situ.Cluster.Log.Entry.decode(binary_part(bytes, 0, 20), 5)
      {:error, "checksum mismatch: the entry was truncated or modified"}
  """
  @spec head_integer(t() | nil, String.t(), default) :: integer() | default when default: term()
  def head_integer(nil, _key, default), do: default

  def head_integer(%__MODULE__{head: head}, key, default) do
    with %{^key => text} <- head, {number, ""} <- Integer.parse(text) do
      number
    else
      _ -> default
    end
  end

  @doc "Encodes an entry: magic, CRC-32 of the rest, length of the head (32 bits), head, data."
  @spec encode(t()) :: iodata()
  def encode(%__MODULE__{op: op, head: head, data: data}) do
    head =
      for({key, value} <- head, do: [key, ": ", value, "\n"]) |> then(&["Op: ", op, "\n" | &1])

    rest = [<<:erlang.iolist_size(head)::32>>, head, data]
    [@magic, <<:erlang.crc32(rest)::32>>, rest]
  end

  @doc "Decodes the entry with number `seq` on its subject."
  @spec decode(binary(), pos_integer()) :: {:ok, t()} | {:error, String.t()}
  def decode(<<@magic, crc::32, rest::binary>>, seq) do
    with true <- :erlang.crc32(rest) == crc,
         <<length::32, head::binary-size(length), data::binary>> <- rest do
      {op, head} = head |> parse_head() |> Map.pop("Op", "")
      {:ok, %__MODULE__{seq: seq, op: op, head: head, data: data}}
    else
      _ -> {:error, "checksum mismatch: the entry was truncated or modified"}
    end
  end

  def decode(_bytes, _seq), do: {:error, "the file is not a log entry"}

  defp parse_head(head) do
    for line <- String.split(head, "\n", trim: true),
        [key, value] <- [String.split(line, ": ", parts: 2)],
        into: %{},
        do: {key, value}
  end
end
