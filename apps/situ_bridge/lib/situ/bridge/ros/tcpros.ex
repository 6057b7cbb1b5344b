defmodule Situ.Bridge.Ros.TcpRos do
  @moduledoc false
  # TCPROS (https://wiki.ros.org/ROS/TCPROS): both sides send a header of fields, then messages with a 32-bit length. A
  # publisher is a server of this protocol, and its `arg` contains the fields of its header. Pure.
  @behaviour Situ.Bridge.Net.Protocol
  alias Situ.Bridge.Net.Protocol
  alias Situ.Bridge.Tcp.Frames

  @max_header 1_000_000

  @doc """
  Encodes a header.

      iex> alias Situ.Bridge.Ros.TcpRos
      iex> bytes = IO.iodata_to_binary(TcpRos.encode_header(%{"topic" => "/a"}))
      iex> TcpRos.read_header(bytes <> "rest")
      {:ok, %{"topic" => "/a"}, "rest"}
  """
  @spec encode_header(%{String.t() => String.t()}) :: iodata()
  def encode_header(fields) do
    lines =
      for {name, value} <- fields,
          line = [name, "=", value],
          do: [<<IO.iodata_length(line)::little-32>>, line]

    [<<IO.iodata_length(lines)::little-32>>, lines]
  end

  @spec read_header(binary()) ::
          {:ok, %{String.t() => String.t()}, binary()} | :more | {:error, String.t()}
  def read_header(<<n::little-32, _::binary>>) when n > @max_header,
    do: {:error, "the header has #{n} bytes, which is too large"}

  def read_header(<<n::little-32, fields::binary-size(n), rest::binary>>) do
    with {:ok, fields} <- parse_fields(fields, %{}), do: {:ok, fields, rest}
  end

  def read_header(_short), do: :more

  defp parse_fields("", fields), do: {:ok, fields}

  defp parse_fields(<<n::little-32, line::binary-size(n), rest::binary>>, fields) do
    case :binary.split(line, "=") do
      [name, value] ->
        parse_fields(rest, Map.put(fields, :binary.copy(name), :binary.copy(value)))

      [_] ->
        {:error, "a field of the header has no ="}
    end
  end

  defp parse_fields(_, _fields), do: {:error, "a field of the header is longer than the header"}

  @doc "Returns nil if both sides agree on the topic (or service) and type, else a sentence about the difference."
  @spec find_mismatch(%{String.t() => String.t()}, %{String.t() => String.t()}) ::
          String.t() | nil
  def find_mismatch(peer_fields, own_fields) do
    Enum.find_value(["topic", "service", "md5sum"], fn field ->
      {peer, own} = {peer_fields[field], own_fields[field]}

      if peer != own and peer != nil and own != nil and "*" not in [peer, own],
        do: "#{field} is #{inspect(own)} here and #{inspect(peer)} there"
    end)
  end

  @impl Protocol
  def admit(bytes, own_fields) do
    with {:ok, peer_fields, rest} <- read_header(bytes) do
      case find_mismatch(peer_fields, own_fields) do
        nil -> {:ok, encode_header(Map.delete(own_fields, "port")), rest}
        why -> {:error, why}
      end
    end
    |> case do
      {:error, why} -> {:refuse, encode_header(%{"error" => why})}
      other -> other
    end
  end

  @impl Protocol
  def frame(payload, _own_fields), do: [<<IO.iodata_length(payload)::little-32>>, payload]

  @impl Protocol
  def handle_bytes(_bytes, _own_fields), do: {:ok, "", ""}

  @impl Protocol
  def hello(_host, _port, fields),
    do: {encode_header(fields), %{fields: fields, peer_fields: nil, rest: ""}}

  @impl Protocol
  def read(bytes, %{peer_fields: nil} = state, max) do
    case read_header(state.rest <> bytes) do
      {:ok, %{"error" => why}, _rest} ->
        {:error, "the publisher refused: #{inspect(why)}"}

      {:ok, peer_fields, rest} ->
        accept_header(find_mismatch(peer_fields, state.fields), peer_fields, rest, state, max)

      :more ->
        {:ok, [], "", %{state | rest: state.rest <> bytes}}

      error ->
        error
    end
  end

  def read(bytes, state, max) do
    with {:ok, payloads, rest} <- Frames.split_frames(state.rest <> bytes, max),
         do: {:ok, payloads, "", %{state | rest: rest}}
  end

  @impl Protocol
  def missing_bytes(%{peer_fields: nil}), do: 1
  def missing_bytes(%{rest: rest}), do: Frames.missing_bytes(rest)

  defp accept_header(nil, peer_fields, rest, state, max),
    do: read(rest, %{state | peer_fields: peer_fields, rest: ""}, max)

  defp accept_header(why, _peer_fields, _rest, _state, _max), do: {:error, why}
end
