defmodule Situ.JSON do
  @moduledoc """
  JSON: jiffy, or Erlang's own `:json` where it has one (OTP 27 and up).

  `nil` is `null`, objects are maps with string keys, and nothing read makes an atom. Text that is not UTF-8 is mended
  on the way out (U+FFFD replaces bytes that are not UTF-8) and refused on the way in.

      iex> Situ.JSON.encode(%{name: "Mic.Level", rate: 100.0, type: nil})
      ...> |> Situ.JSON.decode()
      {:ok, %{"name" => "Mic.Level", "rate" => 100.0, "type" => nil}}

      iex> Situ.JSON.decode(~s({"open": ))
      {:error, :bad_json}

  Where the order of an object's members matters, `{[{key, value}]}` is an object in that order:

      iex> {:ok, ordered} = Situ.JSON.decode(~s({"b":1,"a":{}}), objects: :pairs)
      {:ok, {[{"b", 1}, {"a", {[]}}]}}
      iex> Situ.JSON.encode(ordered)
      ~s({"b":1,"a":{}})
  """

  @type value ::
          nil
          | boolean()
          | number()
          | String.t()
          | atom()
          | [value()]
          | %{optional(atom() | String.t()) => value()}
          | {[{atom() | String.t(), value()}]}

  @doc "The value as one line of text. Raises on what JSON cannot say (tuples, pids, functions)."
  @spec encode(value()) :: String.t()
  def encode(value), do: value |> to_iodata([]) |> IO.iodata_to_binary()

  @doc "The same over several indented lines, for files that people read."
  @spec pretty(value()) :: String.t()
  def pretty(value), do: value |> to_iodata([:pretty]) |> IO.iodata_to_binary()

  # The time to read an integer grows with the square of its digits, and nothing else runs meanwhile.
  @most_digits 400

  @doc """
  Reads one value; its strings are copies and do not hold on to `text`. The last of several equal keys counts; with
  `objects: :pairs` all of them are there, in order.

  A number of more than #{@most_digits} digits is refused: reading it would hold up the whole node.
  """
  @spec decode(binary(), keyword()) :: {:ok, value()} | {:error, :bad_json}
  def decode(text, opts \\ []) when is_binary(text) do
    if long_number?(text), do: {:error, :bad_json}, else: {:ok, parse(text, opts[:objects])}
  catch
    _, _ -> {:error, :bad_json}
  end

  # Digits inside a string are text, however many: only where some stand in a row is it worth telling the two apart.
  defp long_number?(text), do: text =~ ~r/[0-9]{401}/ and outside(text, 0)

  defp outside(_, n) when n > @most_digits, do: true
  defp outside(<<digit, rest::binary>>, n) when digit in ?0..?9, do: outside(rest, n + 1)
  defp outside(<<?", rest::binary>>, _), do: inside(rest)
  defp outside(<<_, rest::binary>>, _), do: outside(rest, 0)
  defp outside("", _), do: false

  defp inside(<<?\\, _, rest::binary>>), do: inside(rest)
  defp inside(<<?", rest::binary>>), do: outside(rest, 0)
  defp inside(<<_, rest::binary>>), do: inside(rest)
  defp inside(""), do: false

  if Code.ensure_loaded?(:json) do
    defp to_iodata(value, options) do
      write(value, options)
    rescue
      ErlangError -> value |> mend() |> write(options)
    end

    defp write(value, []), do: :json.encode(value, &one/2)
    defp write(value, [:pretty]), do: :json.format(value, &one/3, %{indent: 2})

    defp one(nil, _encoder), do: "null"

    defp one({pairs}, encoder) when is_list(pairs),
      do: :json.encode_key_value_list(pairs, encoder)

    defp one(value, encoder), do: :json.encode_value(value, encoder)

    defp one(nil, _encoder, _state), do: "null"

    defp one({pairs}, encoder, state) when is_list(pairs),
      do: :json.format_key_value_list(pairs, encoder, state)

    defp one(value, encoder, state), do: :json.format_value(value, encoder, state)

    defp mend(text) when is_binary(text), do: if(String.valid?(text), do: text, else: valid(text))
    defp mend(list) when is_list(list), do: Enum.map(list, &mend/1)
    defp mend(map) when is_map(map), do: Map.new(map, fn {k, v} -> {mend(k), mend(v)} end)

    defp mend({pairs}) when is_list(pairs),
      do: {Enum.map(pairs, fn {k, v} -> {mend(k), mend(v)} end)}

    defp mend(other), do: other

    defp valid(<<c::utf8, rest::binary>>), do: <<c::utf8, valid(rest)::binary>>
    defp valid(<<_, rest::binary>>), do: <<"\uFFFD", valid(rest)::binary>>
    defp valid(""), do: ""

    defp parse(text, objects) do
      finish = if objects == :pairs, do: &pairs/2, else: &object/2
      decoders = %{null: nil, string: &:binary.copy/1, object_finish: finish}
      {value, :ok, rest} = :json.decode(text, :ok, decoders)
      "" = String.trim(rest)
      value
    end

    # Pairs come last first.
    defp object(pairs, outer), do: {pairs |> Enum.reverse() |> Map.new(), outer}
    defp pairs(pairs, outer), do: {{Enum.reverse(pairs)}, outer}
  else
    defp to_iodata(value, options), do: :jiffy.encode(value, [:use_nil, :force_utf8 | options])

    defp parse(text, :pairs), do: :jiffy.decode(text, [:use_nil, :copy_strings])

    defp parse(text, _objects),
      do: :jiffy.decode(text, [:return_maps, :use_nil, :copy_strings, :dedupe_keys])
  end
end
