defmodule Situ.Studio.FrameSchema do
  @moduledoc false
  # Encodes and decodes the fixed parts of the binary frames between the server and its pages: headers, codes and
  # flags. All values are little-endian. `priv/frames.json` is the only definition of them. This module reads it at
  # compile time, and `npm run frames` generates the pages' part from it (`assets/js/data/frames.js`).

  @path Path.expand("../../../priv/frames.json", __DIR__)
  @external_resource @path

  {:ok, schema} = @path |> File.read!() |> Situ.JSON.decode()

  @codes Map.new(schema["codes"], fn {group, codes} ->
           {String.to_atom(group),
            Map.new(codes, fn {name, code} -> {String.to_atom(name), code} end)}
         end)
  @layouts Map.new(schema["layouts"], fn {name, fields} -> {String.to_atom(name), fields} end)

  type_of = fn
    "u" <> bits -> quote(do: little - unsigned - size(unquote(String.to_integer(bits))))
    "i" <> bits -> quote(do: little - signed - size(unquote(String.to_integer(bits))))
    "f" <> bits -> quote(do: little - float - size(unquote(String.to_integer(bits))))
  end

  segments_of = fn fields, gap ->
    Enum.map(fields, fn
      [nil, bytes] ->
        quote(do: unquote(gap) :: size(unquote(8 * bytes)))

      [name, type, _doc] ->
        quote(do: unquote(Macro.var(String.to_atom(name), nil)) :: unquote(type_of.(type)))
    end)
  end

  @type layout ::
          :reply
          | :frame
          | :line
          | :image
          | :scene
          | :camera
          | :microphone
          | :speaker
          | :headset
          | :drawing

  # [{layout, the values of its fields by name, its fields in a binary, the same fields in a pattern}]
  headers =
    for {layout, fields} <- @layouts do
      named =
        for [name, _, _] <- fields, name = String.to_atom(name), do: {name, Macro.var(name, nil)}

      {layout, named, segments_of.(fields, 0), segments_of.(fields, Macro.var(:_, nil))}
    end

  @doc "Encodes a header from all of its fields."
  @spec encode(layout(), map()) :: binary()
  for {layout, named, fields, _pattern} <- headers do
    def encode(unquote(layout), %{unquote_splicing(named)}), do: <<unquote_splicing(fields)>>
  end

  @doc "Returns a header's fields and the bytes after it, or `:error` if the bytes are not such a header."
  @spec decode(layout(), binary()) :: {map(), binary()} | :error
  for {layout, named, _fields, pattern} <- headers do
    def decode(unquote(layout), <<unquote_splicing(pattern), rest::binary>>),
      do: {%{unquote_splicing(named)}, rest}
  end

  def decode(_layout, _bytes), do: :error

  @doc "Returns the number of a name in a group of codes."
  @spec code(atom(), atom()) :: pos_integer()
  def code(group, name), do: @codes |> Map.fetch!(group) |> Map.fetch!(name)

  @doc "Returns the sum of the flags whose value is `true`."
  @spec encode_flags(atom(), keyword() | map()) :: non_neg_integer()
  def encode_flags(group, values),
    do: Enum.sum(for {name, bit} <- Map.fetch!(@codes, group), values[name] == true, do: bit)

  @doc "Returns 0 or 1 for each flag."
  @spec decode_flags(atom(), non_neg_integer()) :: %{atom() => 0 | 1}
  def decode_flags(group, flags),
    do:
      Map.new(Map.fetch!(@codes, group), fn {name, bit} ->
        {name, min(Bitwise.band(flags, bit), 1)}
      end)

  @doc "Returns a header as a table for documentation."
  @spec layout_table(layout()) :: String.t()
  def layout_table(layout) do
    {rows, _} = @layouts |> Map.fetch!(layout) |> Enum.flat_map_reduce(0, &table_row/2)
    Enum.join(["| bytes | content |", "|---|---|" | rows], "\n")
  end

  defp table_row([nil, bytes], at), do: {[], at + bytes}

  defp table_row([_name, type, doc], at) do
    last = at + div(String.to_integer(String.slice(type, 1..-1//1)), 8) - 1
    {["| #{if last == at, do: at, else: "#{at}..#{last}"} | #{doc} (#{type}) |"], last + 1}
  end
end
