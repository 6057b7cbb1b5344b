defmodule Situ.JSON do
  @moduledoc false
  # Encodes and decodes JSON with Erlang's `:json` module (OTP 27 and later) or, without it, with
  # jiffy.
  #
  # `nil` is `null`, objects are maps with string keys, and decoding never creates atoms. When
  # encoding, bytes that are not valid UTF-8 are replaced by U+FFFD. When decoding, strings that
  # are not valid UTF-8 are rejected.

  @type value ::
          nil
          | boolean()
          | number()
          | String.t()
          | atom()
          | [value()]
          | %{optional(atom() | String.t()) => value()}
          | {[{atom() | String.t(), value()}]}

  @doc """
  Encodes a value on one line. Raises if JSON cannot represent it (tuples, pids, functions).

      iex> Situ.JSON.encode(%{name: "Mic.Level", rate: 100.0, type: nil})
      ...> |> Situ.JSON.decode()
      {:ok, %{"name" => "Mic.Level", "rate" => 100.0, "type" => nil}}
  """
  @spec encode(value()) :: String.t()
  def encode(value), do: value |> to_iodata([]) |> IO.iodata_to_binary()

  @doc "Encodes a value on several indented lines, for files that people read."
  @spec encode_pretty(value()) :: String.t()
  def encode_pretty(value), do: value |> to_iodata([:pretty]) |> IO.iodata_to_binary()

  # The time to parse an integer is quadratic in its number of digits, and the scheduler is blocked in the meantime.
  @most_digits 400

  # jiffy accepts an exponent without digits.
  @exponents ["e+", "e-", "E+", "E-"]

  @doc """
  Decodes one value. Its strings are copies, so they do not keep `text` in memory. If a key occurs several times, the
  last one is used; with `objects: :pairs`, all members are returned in order.

  Numbers of more than #{@most_digits} digits are rejected because parsing them would block the whole node.

  If the order of an object's members matters, use `{[{key, value}]}`, which is an object in that order:

      iex> {:ok, ordered} = Situ.JSON.decode(~s({"b":1,"a":{}}), objects: :pairs)
      {:ok, {[{"b", 1}, {"a", {[]}}]}}
      iex> Situ.JSON.encode(ordered)
      ~s({"b":1,"a":{}})
  """
  @spec decode(binary(), keyword()) :: {:ok, value()} | {:error, :bad_json}
  def decode(text, opts \\ []) when is_binary(text) do
    if invalid_number?(text),
      do: {:error, :bad_json},
      else: {:ok, parse_value(text, opts[:objects])}
  catch
    _, _ -> {:error, :bad_json}
  end

  # Such a number inside a string is harmless, so the text is scanned for strings only if it seems to have one.
  defp invalid_number?(text),
    do:
      (text =~ ~r/[0-9]{401}/ or exponent_without_digits?(text)) and scan_outside_string(text, 0)

  defp exponent_without_digits?(text) do
    text
    |> :binary.matches(@exponents)
    |> Enum.any?(fn {at, 2} ->
      at + 2 >= byte_size(text) or :binary.at(text, at + 2) not in ?0..?9
    end)
  end

  defp scan_outside_string(_, n) when n > @most_digits, do: true

  defp scan_outside_string(<<e, sign, rest::binary>>, _)
       when e in [?e, ?E] and sign in [?+, ?-] do
    case rest do
      <<digit, _::binary>> when digit in ?0..?9 -> scan_outside_string(rest, 0)
      _ -> true
    end
  end

  defp scan_outside_string(<<digit, rest::binary>>, n) when digit in ?0..?9,
    do: scan_outside_string(rest, n + 1)

  defp scan_outside_string(<<?", rest::binary>>, _), do: scan_inside_string(rest)
  defp scan_outside_string(<<_, rest::binary>>, _), do: scan_outside_string(rest, 0)
  defp scan_outside_string("", _), do: false

  defp scan_inside_string(<<?\\, _, rest::binary>>), do: scan_inside_string(rest)
  defp scan_inside_string(<<?", rest::binary>>), do: scan_outside_string(rest, 0)
  defp scan_inside_string(<<_, rest::binary>>), do: scan_inside_string(rest)
  defp scan_inside_string(""), do: false

  if Code.ensure_loaded?(:json) do
    defp to_iodata(value, options) do
      encode_with_json(value, options)
    rescue
      ErlangError -> value |> repair_strings() |> encode_with_json(options)
    end

    defp encode_with_json(value, []), do: :json.encode(value, &encode_value/2)

    defp encode_with_json(value, [:pretty]),
      do: :json.format(value, &encode_value/3, %{indent: 2})

    defp encode_value(nil, _encoder), do: "null"

    defp encode_value({pairs}, encoder) when is_list(pairs),
      do: :json.encode_key_value_list(pairs, encoder)

    defp encode_value(value, encoder), do: :json.encode_value(value, encoder)

    defp encode_value(nil, _encoder, _state), do: "null"

    defp encode_value({pairs}, encoder, state) when is_list(pairs),
      do: :json.format_key_value_list(pairs, encoder, state)

    defp encode_value(value, encoder, state), do: :json.format_value(value, encoder, state)

    defp repair_strings(text) when is_binary(text),
      do: if(String.valid?(text), do: text, else: replace_invalid_bytes(text))

    defp repair_strings(list) when is_list(list), do: Enum.map(list, &repair_strings/1)

    defp repair_strings(map) when is_map(map),
      do: Map.new(map, fn {k, v} -> {repair_strings(k), repair_strings(v)} end)

    defp repair_strings({pairs}) when is_list(pairs),
      do: {Enum.map(pairs, fn {k, v} -> {repair_strings(k), repair_strings(v)} end)}

    defp repair_strings(other), do: other

    defp replace_invalid_bytes(<<c::utf8, rest::binary>>),
      do: <<c::utf8, replace_invalid_bytes(rest)::binary>>

    defp replace_invalid_bytes(<<_, rest::binary>>),
      do: <<"\uFFFD", replace_invalid_bytes(rest)::binary>>

    defp replace_invalid_bytes(""), do: ""

    defp parse_value(text, objects) do
      finish = if objects == :pairs, do: &finish_pairs/2, else: &finish_object/2
      decoders = %{null: nil, string: &:binary.copy/1, object_finish: finish}
      {value, :ok, rest} = :json.decode(text, :ok, decoders)
      "" = String.trim(rest)
      value
    end

    # `:json` passes the pairs in reverse order.
    defp finish_object(pairs, outer), do: {pairs |> Enum.reverse() |> Map.new(), outer}
    defp finish_pairs(pairs, outer), do: {{Enum.reverse(pairs)}, outer}
  else
    defp to_iodata(value, options), do: :jiffy.encode(value, [:use_nil, :force_utf8 | options])

    defp parse_value(text, :pairs), do: :jiffy.decode(text, [:use_nil, :copy_strings])

    defp parse_value(text, _objects),
      do: :jiffy.decode(text, [:return_maps, :use_nil, :copy_strings, :dedupe_keys])
  end
end
