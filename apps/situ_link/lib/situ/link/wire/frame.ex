defmodule Situ.Link.Wire.Frame do
  @moduledoc false
  # Encodes and decodes the frames of a link. Pure.
  #
  # On the wire a frame is a 32-bit big-endian length (which TCP, TLS and Unix sockets add and
  # strip with `packet: 4`) and a body. The body is one byte for the kind of the frame, followed
  # by the fields in the table. Integers are big-endian, `time` is a signed 64-bit number of
  # nanoseconds, and `json` is the rest of the body.
  #
  # | byte | frame | body | from |
  # |---|---|---|---|
  # | 1 | `{:hello, version, oldest, nonce}` | `"SITU"`, version 16, oldest version 16, nonce of 16 bytes | both |
  # | 2 | `{:login, proof, map}` | HMAC of 32 bytes, json | client |
  # | 3 | `{:welcome, proof, map}` | HMAC of 32 bytes, json | server |
  # | 4 | `{:refused, map}` | json: `code`, `what`, `why`, `fix` | server |
  # | 5 | `{:streams, map}` | json: `streams` | server |
  # | 6 | `{:subscribe, channel, map}` | channel 32, json | client |
  # | 7 | `{:subscribed, channel, map}` | channel 32, json | server |
  # | 8 | `{:unsubscribe, channel}` | channel 32 | client |
  # | 9 | `{:credit, channel, bytes}` | channel 32, bytes 32 | client |
  # | 10 | `{:batch, channel, first, last, count, payload}` | channel 32, time, time, count 32, payload | server |
  # | 11 | `{:part, channel, last?, bytes}` | channel 32, 1 when it is the last, bytes of the body of a batch | server |
  # | 12 | `{:closed, channel, time}` | channel 32, time | server |
  # | 13 | `{:lost, channel, count}` | channel 32, count 64 | server |
  # | 14 | `{:ping, t0}` | time | client |
  # | 15 | `{:pong, t0, t1, t2}` | three times | server |
  # | 16 | `{:request, id, map}` | id 32, json | client |
  # | 17 | `{:reply, id, payload}` | id 32, bytes | server |
  # See docs/adr/0110-links-serve-recordings.md.
  alias Situ.JSON

  @version 1
  @magic "SITU"

  @type channel :: 0..0xFFFFFFFF
  @type t ::
          {:hello, version :: 0..0xFFFF, oldest :: 0..0xFFFF, nonce :: <<_::128>>}
          | {:login, proof :: <<_::256>>, map()}
          | {:welcome, proof :: <<_::256>>, map()}
          | {:refused, map()}
          | {:streams, map()}
          | {:subscribe, channel(), map()}
          | {:subscribed, channel(), map()}
          | {:unsubscribe, channel()}
          | {:credit, channel(), 0..0xFFFFFFFF}
          | {:batch, channel(), Situ.Time.t(), Situ.Time.t(), 0..0xFFFFFFFF, iodata()}
          | {:part, channel(), boolean(), iodata()}
          | {:closed, channel(), Situ.Time.t()}
          | {:lost, channel(), non_neg_integer()}
          | {:ping, Situ.Time.t()}
          | {:pong, Situ.Time.t(), Situ.Time.t(), Situ.Time.t()}
          | {:request, 0..0xFFFFFFFF, map()}
          | {:reply, 0..0xFFFFFFFF, iodata()}

  @doc "Returns the protocol version of this release."
  @spec protocol_version() :: 0..0xFFFF
  def protocol_version, do: @version

  @doc """
  Encodes the body of a frame.

      iex> alias Situ.Link.Wire.Frame
      iex> bytes = {:credit, 7, 65_536} |> Frame.encode() |> IO.iodata_to_binary()
      iex> bytes
      <<9, 0, 0, 0, 7, 0, 1, 0, 0>>
      iex> Frame.decode(bytes)
      {:ok, {:credit, 7, 65_536}}
      iex> Frame.decode("GET / HTTP/1.1")
      {:error, "no frame begins with the byte 71"}
  """
  @spec encode(t()) :: iodata()
  def encode({:hello, version, oldest, <<nonce::binary-16>>}),
    do: <<1, @magic, version::16, oldest::16, nonce::binary>>

  def encode({:login, <<proof::binary-32>>, map}), do: [<<2, proof::binary>>, JSON.encode(map)]
  def encode({:welcome, <<proof::binary-32>>, map}), do: [<<3, proof::binary>>, JSON.encode(map)]
  def encode({:refused, map}), do: [4, JSON.encode(map)]
  def encode({:streams, map}), do: [5, JSON.encode(map)]
  def encode({:subscribe, channel, map}), do: [<<6, channel::32>>, JSON.encode(map)]
  def encode({:subscribed, channel, map}), do: [<<7, channel::32>>, JSON.encode(map)]
  def encode({:unsubscribe, channel}), do: <<8, channel::32>>
  def encode({:credit, channel, bytes}), do: <<9, channel::32, bytes::32>>

  def encode({:batch, channel, first, last, count, payload}),
    do: [<<10, channel::32, first::signed-64, last::signed-64, count::32>>, payload]

  def encode({:part, channel, last?, bytes}),
    do: [<<11, channel::32, if(last?, do: 1, else: 0)>>, bytes]

  def encode({:closed, channel, time}), do: <<12, channel::32, time::signed-64>>
  def encode({:lost, channel, count}), do: <<13, channel::32, count::64>>
  def encode({:ping, t0}), do: <<14, t0::signed-64>>
  def encode({:pong, t0, t1, t2}), do: <<15, t0::signed-64, t1::signed-64, t2::signed-64>>
  def encode({:request, id, map}), do: [<<16, id::32>>, JSON.encode(map)]
  def encode({:reply, id, payload}), do: [<<17, id::32>>, payload]

  @doc "Decodes a body. Payloads are sub-binaries of `body`, not copies. Returns the reason as text if it is invalid."
  @spec decode(binary()) :: {:ok, t()} | {:error, String.t()}
  def decode(<<10, channel::32, first::signed-64, last::signed-64, count::32, rest::binary>>),
    do: {:ok, {:batch, channel, first, last, count, rest}}

  def decode(<<11, channel::32, last, rest::binary>>) when last in [0, 1],
    do: {:ok, {:part, channel, last == 1, rest}}

  def decode(<<9, channel::32, bytes::32>>), do: {:ok, {:credit, channel, bytes}}
  def decode(<<14, t0::signed-64>>), do: {:ok, {:ping, t0}}

  def decode(<<15, t0::signed-64, t1::signed-64, t2::signed-64>>),
    do: {:ok, {:pong, t0, t1, t2}}

  def decode(<<12, channel::32, time::signed-64>>), do: {:ok, {:closed, channel, time}}
  def decode(<<13, channel::32, count::64>>), do: {:ok, {:lost, channel, count}}
  def decode(<<8, channel::32>>), do: {:ok, {:unsubscribe, channel}}

  def decode(<<1, @magic, version::16, oldest::16, nonce::binary-16>>),
    do: {:ok, {:hello, version, oldest, nonce}}

  # Later versions may append fields, but their version numbers must remain readable.
  def decode(<<1, @magic, version::16, oldest::16, nonce::binary-16, _::binary>>)
      when version > @version,
      do: {:ok, {:hello, version, oldest, nonce}}

  def decode(<<1, _::binary>>), do: {:error, "the greeting is not from Situ"}

  def decode(<<2, proof::binary-32, json::binary>>),
    do: with_map(json, &{:login, proof, &1})

  def decode(<<3, proof::binary-32, json::binary>>),
    do: with_map(json, &{:welcome, proof, &1})

  def decode(<<4, json::binary>>), do: with_map(json, &{:refused, &1})
  def decode(<<5, json::binary>>), do: with_map(json, &{:streams, &1})
  def decode(<<6, channel::32, json::binary>>), do: with_map(json, &{:subscribe, channel, &1})
  def decode(<<7, channel::32, json::binary>>), do: with_map(json, &{:subscribed, channel, &1})
  def decode(<<16, id::32, json::binary>>), do: with_map(json, &{:request, id, &1})
  def decode(<<17, id::32, payload::binary>>), do: {:ok, {:reply, id, payload}}
  def decode(<<kind, _::binary>>) when kind in 1..17, do: {:error, "a frame #{kind} cut short"}
  def decode(<<kind, _::binary>>), do: {:error, "no frame begins with the byte #{kind}"}
  def decode(<<>>), do: {:error, "an empty frame"}

  defp with_map(json, frame) do
    case JSON.decode(json) do
      {:ok, %{} = map} -> {:ok, frame.(map)}
      _ -> {:error, "the text of a frame is not a JSON object"}
    end
  end
end
