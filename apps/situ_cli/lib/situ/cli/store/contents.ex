defmodule Situ.CLI.Store.Contents do
  @moduledoc false
  # `situ store info --show`: prints the internal structure of an MCAP file.
  alias Situ.Bridge.Mcap
  alias Situ.CLI.Output
  alias Situ.{Error, Store, Time}

  @doc "Returns the names of the parts that can be shown."
  @spec parts() :: [String.t()]
  def parts, do: ~w(channels schemas chunks attachments metadata sizes)

  @spec show([Path.t()], String.t(), keyword()) :: 0
  def show(paths, part, opts) do
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

      shown(part, store, opts)
    end

    0
  end

  defp shown("channels", store, opts) do
    rows(
      Mcap.channels(store),
      opts,
      ~w(channel topic encoding schema messages metadata),
      4,
      fn c ->
        pairs = Enum.map_join(c.metadata, ", ", fn {key, value} -> "#{key}=#{value}" end)
        ["#{c.id}", c.topic, c.encoding, c.schema || "-", "#{c.messages}", pairs]
      end
    )
  end

  defp shown("schemas", store, opts) do
    case {Mcap.schemas(store), opts[:stream]} do
      {schemas, nil} ->
        rows(Enum.map(schemas, &plain/1), opts, ~w(schema name encoding size), 3, fn s ->
          ["#{s.id}", s.name, s.encoding, Output.bytes(s.size)]
        end)

      {schemas, name} ->
        case Enum.find(schemas, &(&1.name == name)) do
          nil ->
            known = schemas |> Enum.take(8) |> Enum.map_join(", ", & &1.name)

            raise Error.new(:no_schema, "#{store.path} has no schema #{inspect(name)}",
                    fix: "its schemas: #{known}"
                  )

          schema ->
            if opts[:json], do: Output.json(plain(schema)), else: Output.raw(schema.definition)
        end
    end
  end

  defp shown("chunks", store, opts) do
    head = ~w(offset size compression data packed ratio first last)

    rows(Mcap.chunks(store), opts, head, 0, fn c ->
      [
        "#{c.offset}",
        Output.bytes(c.size),
        if(c.compression == "", do: "none", else: c.compression),
        Output.bytes(c.unpacked),
        Output.bytes(c.packed),
        if(c.unpacked > 0, do: "#{Float.round(c.packed / c.unpacked, 2)}", else: "-"),
        Time.to_iso8601(c.first),
        Time.to_iso8601(c.last)
      ]
    end)
  end

  defp shown("attachments", store, opts) do
    rows(Mcap.attachments(store), opts, ~w(attachment type time size), 2, fn a ->
      [a.name, a.media_type, Time.to_iso8601(a.time), Output.bytes(a.size)]
    end)
  end

  defp shown("metadata", store, opts) do
    records = for {name, pairs} <- Store.info(store).metadata, do: %{name: name, metadata: pairs}

    rows(records, opts, ~w(record metadata), 2, fn r ->
      [r.name, Enum.map_join(r.metadata, ", ", fn {key, value} -> "#{key}=#{value}" end)]
    end)
  end

  defp shown("sizes", store, opts) do
    sizes = Error.unwrap!(Mcap.sizes(store))
    all = sizes |> Map.values() |> Enum.sum()

    sizes
    |> Enum.sort_by(fn {_, bytes} -> -bytes end)
    |> Enum.map(fn {topic, bytes} -> %{topic: topic, bytes: bytes} end)
    |> rows(opts, ~w(topic data share), 1, fn r ->
      share = if all == 0, do: 0.0, else: 100 * r.bytes / all
      [r.topic, Output.bytes(r.bytes), "#{Float.round(share, 1)} %"]
    end)
  end

  # A definition may be binary, for example a set of Protobuf descriptors.
  defp plain(schema) do
    text? = String.valid?(schema.definition) and String.printable?(schema.definition)
    size = byte_size(schema.definition)

    schema
    |> Map.put(:size, size)
    |> Map.put(:definition, if(text?, do: schema.definition))
  end

  defp rows(items, opts, head, left, row) do
    if opts[:json],
      do: Output.json(items),
      else: Output.table([head | Enum.map(items, row)], left)
  end
end
