defmodule Situ.Store.Catalog do
  @moduledoc false
  # Stream 0 of a store contains JSON records about the other streams. Unknown kinds and keys are ignored.
  alias Situ.Store.{StreamInfo, TypeName}

  defstruct name: nil, volatile?: false, writer: nil, piece: nil, streams: %{}, types: %{}

  # Stream numbers have 32 bits.
  @most 0xFFFFFFFF

  @compressions %{"none" => :none, "lz4" => :lz4, "zstd" => :zstd}

  @spec encode_record(map()) :: binary()
  def encode_record(record), do: Situ.JSON.encode(record)

  @doc "Returns the record that marks a store as a segment with these facts, or `nil`."
  @spec segment_record(map() | nil) :: map() | nil
  def segment_record(nil), do: nil

  def segment_record(%{full?: full?} = mark),
    do: mark |> Map.take([:every, :run, :number]) |> Map.merge(%{kind: "piece", full: full?})

  @spec parse_records([binary()]) :: %__MODULE__{}
  def parse_records(records), do: Enum.reduce(records, %__MODULE__{}, &add_record/2)

  defp add_record(bytes, catalog) do
    {:ok, value} = Situ.JSON.decode(bytes)
    apply_record(value, catalog)
  catch
    # An invalid record must not make the other records unreadable.
    _, _ -> catalog
  end

  # A catalog is untrusted, so values of an unexpected type are ignored.
  defp apply_record(%{"kind" => "store"} = r, catalog) do
    %{
      catalog
      | name: text_or_nil(r["name"]),
        volatile?: r["volatile"] == true,
        writer: text_or_nil(r["writer"])
    }
  end

  defp apply_record(%{"kind" => "stream", "id" => id, "name" => name} = r, catalog)
       when id in 1..@most and is_binary(name) do
    type_name = text_or_nil(r["type"]) || ":any"
    {type, catalog} = resolve_type(type_name, catalog)

    info = %StreamInfo{
      id: id,
      name: name,
      type: type,
      type_name: type_name,
      opened: if(valid_time?(r["opened"]), do: r["opened"]),
      large?: r["large"] == true,
      compression: @compressions[r["compression"]] || :none
    }

    put_in(catalog.streams[id], info)
  end

  defp apply_record(
         %{"kind" => "codec", "id" => id, "number" => number, "name" => name} = r,
         catalog
       )
       when number in 1..0xFFFF and is_binary(name) do
    update_stream(
      catalog,
      id,
      &%{&1 | codecs: Map.put(&1.codecs, number, {name, text_or_nil(r["module"])})}
    )
  end

  defp apply_record(%{"kind" => "fields", "id" => id, "fields" => fields} = r, catalog)
       when is_list(fields) do
    update_stream(catalog, id, fn info ->
      if info.fields == nil and Enum.all?(fields, &is_binary/1),
        do: %{info | module: text_or_nil(r["module"]), fields: fields},
        else: info
    end)
  end

  defp apply_record(%{"kind" => "metadata", "id" => id, "term" => term} = r, catalog)
       when is_binary(term) do
    type = text_or_nil(r["type"]) || ":any"
    update_stream(catalog, id, &%{&1 | supplemental: {type, Base.decode64!(term)}})
  end

  defp apply_record(%{"kind" => "closed", "id" => id, "time" => time}, catalog) do
    if valid_time?(time), do: update_stream(catalog, id, &%{&1 | closed: time}), else: catalog
  end

  defp apply_record(%{"kind" => "piece"} = r, catalog) do
    every = if is_integer(r["every"]) and r["every"] > 0, do: r["every"]
    before = catalog.piece || %{every: nil, full?: false, run: nil, number: nil}

    piece = %{
      every: every || before.every,
      full?: r["full"] == true or before.full?,
      run: before.run || text_or_nil(r["run"]),
      number: before.number || if(is_integer(r["number"]), do: r["number"])
    }

    %{catalog | piece: piece}
  end

  defp apply_record(_, catalog), do: catalog

  defp text_or_nil(text) when is_binary(text), do: text
  defp text_or_nil(_), do: nil

  # Times have 64 bits.
  defp valid_time?(time),
    do: is_integer(time) and time in -0x8000000000000000..0x7FFFFFFFFFFFFFFF

  # Thousands of streams share a few types, so each type name is parsed only once.
  defp resolve_type(text, %{types: types} = catalog) when is_map_key(types, text),
    do: {types[text], catalog}

  defp resolve_type(text, catalog) do
    type =
      case TypeName.parse_type(text) do
        {:ok, type} -> type
        :error -> :any
      end

    {type, %{catalog | types: Map.put(catalog.types, text, type)}}
  end

  defp update_stream(catalog, id, fun) do
    case catalog.streams do
      %{^id => info} -> %{catalog | streams: Map.put(catalog.streams, id, fun.(info))}
      _ -> catalog
    end
  end
end
