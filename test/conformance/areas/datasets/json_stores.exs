defmodule Situ.Conformance.Datasets.JsonStores do
  # Reads \psi's JSON stores with a pipeline and by time.
  import Situ.Conformance.Case
  alias Situ.{Pipeline, Store, Time}

  def run(_op, params, case, root) do
    name = params["catalog"] |> List.first(%{}) |> Map.get("StoreName", "JsonStore")
    path = Path.join(root, "#{name}.Catalog.json")
    File.write!(path, Situ.JSON.encode(params["catalog"]))
    File.write!(Path.join(root, "#{name}.Data.json"), Situ.JSON.encode(params["data"]))
    from = params["from"] || params["seek"]
    check(case["expect"], params, replayed(Store.open!(path), from))
  end

  # Reads the messages of every stream with a pipeline.
  defp replayed(store, from) do
    test = self()
    names = Enum.map(Store.streams(store), & &1.name)

    {:ok, _} =
      Pipeline.run(
        fn p ->
          importer = Store.importer(p, store)

          for name <- names do
            importer
            |> Store.stream(name)
            |> Situ.each(fn _, m -> send(test, {:got, name, m}) end)
          end
        end,
        pipeline: if(from, do: [replay: [interval: {time!(from), :unbounded}]], else: [])
      )

    Map.new(names, &{&1, received(&1)})
  end

  defp received(name) do
    receive do
      {:got, ^name, message} -> [message | received(name)]
    after
      0 -> []
    end
  end

  defp check(expect, params, got) do
    Enum.find_value(expect, :pass, fn {key, wanted} ->
      case one(key, wanted, params, got) do
        :pass -> nil
        other -> other
      end
    end)
  end

  defp one("values", "equal", params, got) do
    names = Map.new(params["catalog"], &{&1["Id"], &1["Name"]})

    # The messages of each stream in order. A replay numbers them from 1.
    wanted =
      params["data"]
      |> Enum.sort_by(& &1["Envelope"]["SequenceId"])
      |> Enum.group_by(&names[&1["Envelope"]["SourceId"]], & &1["Data"])

    verdict(
      wanted,
      Map.new(got, fn {name, messages} -> {name, Enum.map(messages, & &1.data)} end)
    )
  end

  defp one(key, wanted, _params, got) do
    case Regex.run(~r/\A(.+)_(times|values|count)\z/, key) do
      [_, name, what] when is_map_key(got, name) -> stream(what, wanted, got[name])
      _ -> {:fail, %{key => wanted}, "no meaning known for #{key}"}
    end
  end

  defp stream("times", wanted, messages),
    do: verdict(Enum.map(wanted, &time!/1), Enum.map(messages, & &1.originating_time))

  defp stream("values", wanted, messages), do: verdict(wanted, Enum.map(messages, & &1.data))
  defp stream("count", wanted, messages), do: verdict(wanted, length(messages))

  defp time!(text) do
    {:ok, time} = Time.parse(text)
    time
  end
end
