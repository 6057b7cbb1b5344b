defmodule Situ.Live.Json do
  @moduledoc false
  # JSON by Erlang's own `:json` where it has one (OTP 27 and up), else by jiffy: `nil` is null, text that is not UTF-8 is
  # mended on the way out and refused on the way in. What the runtime has as Situ.JSON, which this app may not know.

  @spec encode(term()) :: binary()
  def encode(value), do: value |> to_iodata() |> IO.iodata_to_binary()

  @spec decode(binary()) :: {:ok, term()} | {:error, :bad_json}
  def decode(text) when is_binary(text) do
    {:ok, parse(text)}
  catch
    _, _ -> {:error, :bad_json}
  end

  def decode(_), do: {:error, :bad_json}

  if Code.ensure_loaded?(:json) do
    defp to_iodata(value) do
      :json.encode(value, &one/2)
    rescue
      ErlangError -> value |> mend() |> :json.encode(&one/2)
    end

    defp one(nil, _encoder), do: "null"
    defp one(value, encoder), do: :json.encode_value(value, encoder)

    defp mend(text) when is_binary(text), do: if(String.valid?(text), do: text, else: valid(text))
    defp mend(list) when is_list(list), do: Enum.map(list, &mend/1)
    defp mend(map) when is_map(map), do: Map.new(map, fn {k, v} -> {mend(k), mend(v)} end)
    defp mend(other), do: other

    defp valid(<<c::utf8, rest::binary>>), do: <<c::utf8, valid(rest)::binary>>
    defp valid(<<_, rest::binary>>), do: <<"\uFFFD", valid(rest)::binary>>
    defp valid(""), do: ""

    defp parse(text) do
      decoders = %{null: nil, string: &:binary.copy/1, object_finish: &object/2}
      {value, :ok, rest} = :json.decode(text, :ok, decoders)
      "" = String.trim(rest)
      value
    end

    # Pairs come last first.
    defp object(pairs, outer), do: {pairs |> Enum.reverse() |> Map.new(), outer}
  else
    defp to_iodata(value), do: :jiffy.encode(value, [:use_nil, :force_utf8])

    defp parse(text),
      do: :jiffy.decode(text, [:return_maps, :use_nil, :copy_strings, :dedupe_keys])
  end
end
