defmodule Situ.Store.Catalog do
  @moduledoc false
  # Stream 0 of a store: JSON records about the others. Unknown kinds and keys are ignored.
  alias Situ.Store.{StreamInfo, TypeName}

  defstruct name: nil, volatile?: false, writer: nil, piece: nil, streams: %{}, types: %{}

  # Numbers of streams have 32 bits.
  @most 0xFFFFFFFF

  @compressions %{"none" => :none, "lz4" => :lz4, "zstd" => :zstd}

  @spec encode(map()) :: binary()
  def encode(record), do: Situ.JSON.encode(record)

  @spec parse([binary()]) :: %__MODULE__{}
  def parse(records), do: Enum.reduce(records, %__MODULE__{}, &add/2)

  defp add(bytes, catalog) do
    {:ok, value} = Situ.JSON.decode(bytes)
    record(value, catalog)
  catch
    # A record nobody understands takes nothing else with it.
    _, _ -> catalog
  end

  defp record(%{"kind" => "store"} = r, catalog) do
    %{catalog | name: r["name"], volatile?: r["volatile"] == true, writer: r["writer"]}
  end

  defp record(%{"kind" => "stream", "id" => id, "name" => name} = r, catalog)
       when id in 1..@most and is_binary(name) do
    {type, catalog} = type(r["type"], catalog)

    info = %StreamInfo{
      id: id,
      name: name,
      type: type,
      type_name: to_string(r["type"]),
      opened: r["opened"],
      large?: r["large"] == true,
      compression: @compressions[r["compression"]] || :none
    }

    put_in(catalog.streams[id], info)
  end

  defp record(%{"kind" => "codec", "id" => id, "number" => number, "name" => name} = r, catalog),
    do: update(catalog, id, &%{&1 | codecs: Map.put(&1.codecs, number, {name, r["module"]})})

  defp record(%{"kind" => "fields", "id" => id} = r, catalog) do
    update(catalog, id, fn info ->
      if info.fields, do: info, else: %{info | module: r["module"], fields: r["fields"]}
    end)
  end

  defp record(%{"kind" => "metadata", "id" => id, "term" => term} = r, catalog),
    do: update(catalog, id, &%{&1 | supplemental: {r["type"], Base.decode64!(term)}})

  defp record(%{"kind" => "closed", "id" => id, "time" => time}, catalog),
    do: update(catalog, id, &%{&1 | closed: time})

  defp record(%{"kind" => "piece"} = r, catalog),
    do: %{catalog | piece: Map.merge(catalog.piece || %{}, Map.take(r, ["every", "full"]))}

  defp record(_, catalog), do: catalog

  # Thousands of streams have few types.
  defp type(text, %{types: types} = catalog) when is_map_key(types, text),
    do: {types[text], catalog}

  defp type(text, catalog) do
    type =
      case TypeName.read(text || ":any") do
        {:ok, type} -> type
        :error -> :any
      end

    {type, %{catalog | types: Map.put(catalog.types, text, type)}}
  end

  defp update(catalog, id, fun) do
    case catalog.streams do
      %{^id => info} -> %{catalog | streams: Map.put(catalog.streams, id, fun.(info))}
      _ -> catalog
    end
  end
end
