defmodule Situ.CLI.Store.McapStructure do
  @moduledoc false
  # `situ store info --show`: prints the internal structure of an MCAP file.
  alias Situ.Bridge.Mcap
  alias Situ.CLI.Output
  alias Situ.{Error, Store, Time}

  @doc "Returns the names of the parts that can be shown."
  @spec part_names() :: [String.t()]
  def part_names, do: ~w(channels schemas chunks attachments metadata sizes)

  @spec show_part([Path.t()], String.t(), keyword()) :: 0
  def show_part(paths, part, opts) do
    for path <- paths do
      store = Store.open!(path)

      unless store.module == Mcap,
        do:
          raise(
            Error.new(:no_parts, "#{path} is not an MCAP file",
              why: "only MCAP files have #{part}",
              fix: "omit --show"
            )
          )

      print_part(part, store, opts)
    end

    0
  end

  defp print_part("channels", store, opts) do
    print_rows(
      Mcap.list_channels(store),
      opts,
      ~w(channel topic encoding schema messages metadata),
      4,
      fn c ->
        pairs = Enum.map_join(c.metadata, ", ", fn {key, value} -> "#{key}=#{value}" end)
        ["#{c.id}", c.topic, c.encoding, c.schema || "-", "#{c.messages}", pairs]
      end
    )
  end

  defp print_part("schemas", store, opts) do
    case {Mcap.list_schemas(store), opts[:stream]} do
      {schemas, nil} ->
        print_rows(
          Enum.map(schemas, &printable_schema/1),
          opts,
          ~w(schema name encoding size),
          3,
          fn s ->
            ["#{s.id}", s.name, s.encoding, Output.format_bytes(s.size)]
          end
        )

      {schemas, name} ->
        case Enum.find(schemas, &(&1.name == name)) do
          nil ->
            known = schemas |> Enum.take(8) |> Enum.map_join(", ", & &1.name)

            raise Error.new(:no_schema, "#{store.path} has no schema #{inspect(name)}",
                    fix: "its schemas: #{known}"
                  )

          schema ->
            if opts[:json],
              do: Output.print_json(printable_schema(schema)),
              else: Output.write_raw(schema.definition)
        end
    end
  end

  defp print_part("chunks", store, opts) do
    head = ~w(offset size compression data packed ratio first last)

    print_rows(Mcap.list_chunks(store), opts, head, 0, fn c ->
      [
        "#{c.offset}",
        Output.format_bytes(c.size),
        if(c.compression == "", do: "none", else: c.compression),
        Output.format_bytes(c.unpacked),
        Output.format_bytes(c.packed),
        if(c.unpacked > 0, do: "#{Float.round(c.packed / c.unpacked, 2)}", else: "-"),
        Time.to_iso8601(c.first),
        Time.to_iso8601(c.last)
      ]
    end)
  end

  defp print_part("attachments", store, opts) do
    print_rows(Mcap.list_attachments(store), opts, ~w(attachment type time size), 2, fn a ->
      [a.name, a.media_type, Time.to_iso8601(a.time), Output.format_bytes(a.size)]
    end)
  end

  defp print_part("metadata", store, opts) do
    records = for {name, pairs} <- Store.info(store).metadata, do: %{name: name, metadata: pairs}

    print_rows(records, opts, ~w(record metadata), 2, fn r ->
      [r.name, Enum.map_join(r.metadata, ", ", fn {key, value} -> "#{key}=#{value}" end)]
    end)
  end

  defp print_part("sizes", store, opts) do
    sizes = Error.unwrap!(Mcap.topic_sizes(store))
    all = sizes |> Map.values() |> Enum.sum()

    sizes
    |> Enum.sort_by(fn {_, bytes} -> -bytes end)
    |> Enum.map(fn {topic, bytes} -> %{topic: topic, bytes: bytes} end)
    |> print_rows(opts, ~w(topic data share), 1, fn r ->
      share = if all == 0, do: 0.0, else: 100 * r.bytes / all
      [r.topic, Output.format_bytes(r.bytes), "#{Float.round(share, 1)} %"]
    end)
  end

  # A definition may be binary, for example a set of Protobuf descriptors.
  defp printable_schema(schema) do
    text? = String.valid?(schema.definition) and String.printable?(schema.definition)
    size = byte_size(schema.definition)

    schema
    |> Map.put(:size, size)
    |> Map.put(:definition, if(text?, do: schema.definition))
  end

  defp print_rows(items, opts, head, left, row) do
    if opts[:json],
      do: Output.print_json(items),
      else: Output.print_table([head | Enum.map(items, row)], left)
  end
end
