defmodule Situ.Bridge.ZeroMQ.Wire do
  @moduledoc false
  # ZMTP 3.0 (https://rfc.zeromq.org/spec/23/) with the NULL mechanism: greeting, READY, frames, subscriptions. Pure.
  import Bitwise

  @greeting <<0xFF, 0::64, 0x7F, 3, 0, "NULL", 0::128, 0, 0::248>>
  @names %{pub: "PUB", sub: "SUB", push: "PUSH", pull: "PULL"}
  # The socket types that each type may connect to; XPUB and XSUB are the types of proxies.
  @peers %{pub: ["SUB", "XSUB"], sub: ["PUB", "XPUB"], push: ["PULL"], pull: ["PUSH"]}

  @type type :: :pub | :sub | :push | :pull
  @type event :: {:message, [binary()]} | {:subscribe | :unsubscribe, binary()}

  @doc "Returns the 64-byte greeting of both sides."
  def greeting, do: @greeting

  @doc "Checks the greeting of the other side."
  @spec parse_greeting(binary()) :: {:ok, rest :: binary()} | :more | {:error, String.t()}
  def parse_greeting(
        <<0xFF, _::64, 0x7F, major, _minor, mechanism::binary-20, _::binary-32, rest::binary>>
      ) do
    cond do
      major < 3 ->
        {:error, "it uses ZMTP #{major}, which is older than the required version 3"}

      String.trim_trailing(mechanism, <<0>>) != "NULL" ->
        {:error,
         "it requires the mechanism #{inspect(String.trim_trailing(mechanism, <<0>>))}, but only NULL is supported"}

      true ->
        {:ok, rest}
    end
  end

  def parse_greeting(<<0xFF, _::binary>> = short) when byte_size(short) < 64, do: :more
  def parse_greeting(""), do: :more
  def parse_greeting(_), do: {:error, "its greeting is not ZMTP"}

  @doc "Encodes the command that announces the type of this socket."
  @spec encode_ready(type()) :: iodata()
  def encode_ready(type) do
    name = @names[type]
    body = <<5, "READY", 11, "Socket-Type", byte_size(name)::32, name::binary>>
    [<<0x04, byte_size(body)>>, body]
  end

  @doc "Checks the READY command of the other side, whose socket type must be compatible with `type`."
  @spec parse_ready(binary(), type(), pos_integer()) ::
          {:ok, rest :: binary()} | :more | {:error, String.t()}
  def parse_ready(bytes, type, max) do
    case parse_frame(bytes, max) do
      {:ok, {flags, <<5, "READY", properties::binary>>}, rest} when (flags &&& 4) != 0 ->
        peer_type = find_property(properties, "socket-type")

        if peer_type in @peers[type],
          do: {:ok, rest},
          else:
            {:error,
             "it is a #{peer_type || "socket without a type"}, which is incompatible with #{@names[type]}"}

      {:ok, {flags, <<5, "ERROR", n, reason::binary-size(n), _::binary>>}, _}
      when (flags &&& 4) != 0 ->
        {:error, "it refused the connection: #{reason}"}

      {:ok, _, _} ->
        {:error, "it sent something else before READY"}

      other ->
        other
    end
  end

  defp find_property(
         <<n, name::binary-size(n), m::32, value::binary-size(m), rest::binary>>,
         property
       ),
       do: if(String.downcase(name) == property, do: value, else: find_property(rest, property))

  defp find_property(_, _property), do: nil

  @doc "Encodes a message of several frames."
  @spec encode_message([iodata()]) :: iodata()
  def encode_message([last]), do: encode_frame(last, 0)
  def encode_message([frame | frames]), do: [encode_frame(frame, 1) | encode_message(frames)]

  @doc "Encodes a subscription or its end, for topics that begin with `prefix`."
  @spec encode_subscription(:subscribe | :unsubscribe, binary()) :: iodata()
  def encode_subscription(:subscribe, prefix), do: encode_message([<<1, prefix::binary>>])
  def encode_subscription(:unsubscribe, prefix), do: encode_message([<<0, prefix::binary>>])

  defp encode_frame(frame, flags) do
    case IO.iodata_length(frame) do
      n when n < 256 -> [<<flags, n>>, frame]
      n -> [<<flags ||| 2, n::64>>, frame]
    end
  end

  @doc """
  Parses the complete messages in `bytes`; `parts` are the frames of an incomplete message. Returns the messages in
  order, the frames of the incomplete message, and the remaining bytes.
  """
  @spec parse_events(binary(), [binary()], type(), pos_integer()) ::
          {:ok, [event()], [binary()], binary()} | {:error, String.t()}
  def parse_events(bytes, parts, type, max), do: collect_events(bytes, parts, type, max, [])

  defp collect_events(bytes, parts, type, max, events) do
    case parse_frame(bytes, max - parts_size(parts)) do
      {:ok, {flags, body}, rest} when (flags &&& 4) != 0 ->
        collect_events(rest, parts, type, max, parse_command(body) ++ events)

      {:ok, {flags, body}, rest} when (flags &&& 1) != 0 ->
        collect_events(rest, [body | parts], type, max, events)

      {:ok, {_flags, body}, rest} ->
        collect_events(rest, [], type, max, [
          to_event(type, Enum.reverse([body | parts])) | events
        ])

      :more ->
        {:ok, Enum.reverse(events), parts, bytes}

      error ->
        error
    end
  end

  @doc "Returns the minimum number of bytes that an incomplete frame lacks."
  @spec missing_bytes(binary()) :: pos_integer()
  def missing_bytes(<<flags, n::64, rest::binary>>) when (flags &&& 2) != 0,
    do: max(n - byte_size(rest), 1)

  def missing_bytes(<<_flags, n, rest::binary>>), do: max(n - byte_size(rest), 1)
  def missing_bytes(_short), do: 1

  defp parts_size(parts), do: parts |> Enum.map(&(byte_size(&1) + 9)) |> Enum.sum()

  defp to_event(:pub, [<<1, prefix::binary>>]), do: {:subscribe, prefix}
  defp to_event(:pub, [<<0, prefix::binary>>]), do: {:unsubscribe, prefix}
  defp to_event(_type, frames), do: {:message, frames}

  # ZMTP 3.1 peers may use commands to subscribe.
  defp parse_command(<<9, "SUBSCRIBE", prefix::binary>>), do: [{:subscribe, prefix}]
  defp parse_command(<<6, "CANCEL", prefix::binary>>), do: [{:unsubscribe, prefix}]
  defp parse_command(_other), do: []

  defp parse_frame(<<flags, _::binary>>, _max) when flags > 7,
    do: {:error, "a frame with the reserved flags #{flags}"}

  defp parse_frame(<<flags, n::64, _::binary>>, max) when (flags &&& 2) != 0 and n > max,
    do: {:error, "a message of more than #{max} bytes"}

  defp parse_frame(<<flags, n::64, body::binary-size(n), rest::binary>>, _max)
       when (flags &&& 2) != 0,
       do: {:ok, {flags, :binary.copy(body)}, rest}

  defp parse_frame(<<flags, n, _::binary>>, max) when (flags &&& 2) == 0 and n > max,
    do: {:error, "a message of more bytes than allowed"}

  defp parse_frame(<<flags, n, body::binary-size(n), rest::binary>>, _max)
       when (flags &&& 2) == 0,
       do: {:ok, {flags, :binary.copy(body)}, rest}

  defp parse_frame(_short, _max), do: :more
end
