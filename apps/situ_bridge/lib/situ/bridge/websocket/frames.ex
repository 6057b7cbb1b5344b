defmodule Situ.Bridge.WebSocket.Frames do
  @moduledoc false
  # Encodes and decodes WebSocket frames (RFC 6455, section 5). Pure.
  import Situ.BinarySize, only: [pinned_size: 1]
  import Bitwise

  @opcodes %{1 => :text, 2 => :binary, 8 => :close, 9 => :ping, 10 => :pong}
  @numbers Map.new(@opcodes, fn {number, name} -> {name, number} end)

  @type event :: {:text | :binary | :close | :ping | :pong, binary()}
  # The kind and the parts of an incomplete message, or `nil`.
  @type partial :: {:text | :binary, [binary()]} | nil

  @doc """
  Encodes one frame; a client masks it with four random bytes.

      iex> Situ.Bridge.WebSocket.Frames.encode_frame(:text, "hi") |> IO.iodata_to_binary()
      <<0x81, 2, "hi">>
  """
  @spec encode_frame(atom(), iodata(), mask :: binary() | nil) :: iodata()
  def encode_frame(kind, payload, mask \\ nil) do
    head = <<1::1, 0::3, @numbers[kind]::4>>
    [head, encode_length(IO.iodata_length(payload), mask) | encode_body(payload, mask)]
  end

  defp encode_length(n, mask) when n < 126, do: <<mask_bit(mask)::1, n::7>>
  defp encode_length(n, mask) when n < 65_536, do: <<mask_bit(mask)::1, 126::7, n::16>>
  defp encode_length(n, mask), do: <<mask_bit(mask)::1, 127::7, n::64>>

  defp mask_bit(nil), do: 0
  defp mask_bit(_mask), do: 1

  defp encode_body(payload, nil), do: [payload]

  defp encode_body(payload, mask),
    do: [mask, payload |> IO.iodata_to_binary() |> apply_mask(mask)]

  defp apply_mask(payload, mask) do
    n = byte_size(payload)
    :crypto.exor(payload, binary_part(:binary.copy(mask, div(n, 4) + 1), 0, n))
  end

  @doc """
  Splits `bytes` into complete messages; returns them with the remaining bytes and the incomplete message, if any.
  Frames must be masked (sent by a client) if `masked?` is true, and unmasked otherwise. Errors are sentences.
  """
  @spec split_messages(binary(), partial(), masked? :: boolean(), max :: pos_integer()) ::
          {:ok, [event()], binary(), partial()} | {:error, String.t()}
  def split_messages(bytes, partial, masked?, max),
    do: collect_events(bytes, partial, {masked?, max}, [])

  defp collect_events(bytes, partial, {masked?, max} = rules, events) do
    case parse_frame(bytes, max) do
      :more ->
        {:ok, Enum.reverse(events), bytes, partial}

      {:ok, _fin, _opcode, mask, _payload, _rest} when is_nil(mask) == masked? ->
        {:error, "a frame that is #{if masked?, do: "not ", else: ""}masked"}

      {:ok, fin, opcode, mask, payload, rest} ->
        payload = if mask, do: apply_mask(payload, mask), else: :binary.copy(payload)

        with {:ok, event, partial} <- add_frame(opcode, fin, payload, partial, max),
             do: collect_events(rest, partial, rules, List.wrap(event) ++ events)

      error ->
        error
    end
  end

  defp parse_frame(<<_fin::1, reserved::3, _::bitstring>>, _max) when reserved != 0,
    do: {:error, "a frame with reserved bits"}

  defp parse_frame(<<fin::1, 0::3, opcode::4, m::1, 127::7, n::64, rest::binary>>, max),
    do: split_frame(fin, opcode, m, n, rest, max)

  defp parse_frame(<<fin::1, 0::3, opcode::4, m::1, 126::7, n::16, rest::binary>>, max),
    do: split_frame(fin, opcode, m, n, rest, max)

  defp parse_frame(<<fin::1, 0::3, opcode::4, m::1, n::7, rest::binary>>, max) when n < 126,
    do: split_frame(fin, opcode, m, n, rest, max)

  defp parse_frame(_short, _max), do: :more

  defp split_frame(_fin, _opcode, _m, n, _rest, max) when n > max,
    do: {:error, "a frame of #{n} bytes; the limit is #{max}"}

  defp split_frame(fin, opcode, m, n, bytes, _max) do
    case bytes do
      <<mask::binary-4, payload::binary-pinned_size(n), rest::binary>> when m == 1 ->
        {:ok, fin, opcode, mask, payload, rest}

      <<payload::binary-pinned_size(n), rest::binary>> when m == 0 ->
        {:ok, fin, opcode, nil, payload, rest}

      _ ->
        :more
    end
  end

  @doc "Returns the minimum number of bytes that an incomplete frame lacks."
  @spec missing_bytes(binary()) :: pos_integer()
  def missing_bytes(<<_, m::1, 127::7, n::64, rest::binary>>), do: remaining_bytes(m, n, rest)
  def missing_bytes(<<_, m::1, 126::7, n::16, rest::binary>>), do: remaining_bytes(m, n, rest)
  def missing_bytes(<<_, m::1, n::7, rest::binary>>) when n < 126, do: remaining_bytes(m, n, rest)
  def missing_bytes(_short), do: 1

  defp remaining_bytes(masked, n, rest), do: max(4 * masked + n - byte_size(rest), 1)

  # Control frames are never fragmented, and may arrive between the parts of a message.
  defp add_frame(opcode, fin, payload, partial, _max) when (opcode &&& 8) != 0 do
    case @opcodes[opcode] do
      kind when kind != nil and fin == 1 and byte_size(payload) < 126 ->
        {:ok, {kind, payload}, partial}

      _ ->
        {:error, "an invalid control frame"}
    end
  end

  defp add_frame(0, _fin, _payload, nil, _max),
    do: {:error, "a continuation frame without a first frame"}

  defp add_frame(0, fin, payload, {kind, parts}, max) do
    parts = [payload | parts]

    cond do
      parts |> Enum.map(&byte_size/1) |> Enum.sum() > max ->
        {:error, "a message of more than #{max} bytes"}

      fin == 1 ->
        {:ok, {kind, parts |> Enum.reverse() |> IO.iodata_to_binary()}, nil}

      true ->
        {:ok, nil, {kind, parts}}
    end
  end

  defp add_frame(opcode, fin, payload, nil, _max) when opcode in [1, 2] do
    if fin == 1,
      do: {:ok, {@opcodes[opcode], payload}, nil},
      else: {:ok, nil, {@opcodes[opcode], [payload]}}
  end

  defp add_frame(opcode, _fin, _payload, _partial, _max),
    do: {:error, "an unexpected frame with opcode #{opcode}"}
end
