defmodule Situ.GoldenValues do
  # The contents of recordings as plain JSON, which other languages can produce, too. A value with a codec is the hash
  # of its encoded bytes, a struct is a map with its type, an atom is its name, and a tuple is a list.
  alias Situ.Store

  def describe(path, options \\ []) do
    store = Store.open!(path)

    for stream <- Store.streams(store), into: %{} do
      messages =
        for message <- Store.messages(store, stream.name, options),
            do: [message.originating_time, message.creation_time, to_json(message.data)]

      {stream.name, messages}
    end
  end

  def to_json(value) when is_number(value) or is_boolean(value) or is_nil(value), do: value
  def to_json(value) when is_atom(value), do: Atom.to_string(value)
  def to_json(value) when is_list(value), do: Enum.map(value, &to_json/1)
  def to_json(value) when is_tuple(value), do: value |> Tuple.to_list() |> to_json()

  def to_json(value) when is_binary(value),
    do: if(String.valid?(value), do: value, else: %{"bytes" => Base.encode16(value)})

  def to_json(%module{} = value) do
    if Code.ensure_loaded?(module) and function_exported?(module, :encode, 1) do
      bytes = value |> module.encode() |> IO.iodata_to_binary()
      %{"type" => inspect(module), "sha256" => Base.encode16(:crypto.hash(:sha256, bytes))}
    else
      value |> Map.from_struct() |> to_json() |> Map.put("type", inspect(module))
    end
  end

  def to_json(%{} = map),
    do: Map.new(map, fn {key, value} -> {to_string(to_json(key)), to_json(value)} end)
end
