defmodule Situ.Conformance.Store.Contents do
  # What a store knows of its streams: times, types, metadata, and how today's types read yesterday's data.
  import Situ.Conformance.Case, only: [verdict: 2, plain: 1]
  import Situ.Conformance.Store.Tape
  alias Situ.{Message, Pipeline, Store}
  alias Situ.Store.{StreamInfo, Writer}

  def run("metadata", params, case, root) do
    streams = streams(case)
    path = record(root, streams)
    store = Store.open!(path)
    infos = Store.streams(store)
    all = Enum.flat_map(streams, fn {name, _} -> Enum.to_list(Store.messages(store, name)) end)
    creation = Enum.map(all, & &1.creation_time)

    range? =
      Store.creation_interval(store) == {Enum.min(creation), Enum.max(creation)} and
        Enum.all?(infos, &(&1.first_creation <= &1.last_creation))

    opened =
      for name <- params["opened"] || [] do
        {name, own} = List.keyfind(streams, name, 0)
        test = self()

        {:ok, report} =
          Pipeline.run(fn p ->
            p |> Store.importer(path) |> Store.stream(name) |> tell(test)
          end)

        got = told()
        info = Enum.find(infos, &(&1.name == name))
        [first | _] = times = times(own)

        report.start_time == first and {info.first, info.last} == {first, List.last(times)} and
          length(got) == (case["expect"]["messages_read"] || length(own))
      end

    if range? and Enum.all?(opened),
      do: figures(case, infos),
      else: {:fail, case["expect"], {infos, opened}}
  end

  def run("supplemental", %{"value" => value}, case, root) do
    term = if is_list(value), do: List.to_tuple(value), else: value
    {:ok, writer} = Writer.create("meta", root)
    {:ok, _} = Writer.stream(writer, "WithMeta", metadata: term)
    {:ok, _} = Writer.stream(writer, "NoMeta")
    :ok = Writer.close(writer)
    store = Store.open!(writer.path)
    other = if is_integer(term), do: :string, else: :integer

    case {Store.metadata(store, "WithMeta"), Store.metadata(store, "NoMeta"),
          Store.metadata(store, "WithMeta", other)} do
      {{:ok, ^term}, {:error, %{code: :no_metadata}}, {:error, %{code: :type_mismatch}}} -> :pass
      other -> {:fail, case["expect"], other}
    end
  end

  # The keys of maps, noted while they were written; what is told of a stream is the set of them.
  def run(op, _params, case, root) when op in ["supplemental", "distinct_keys"] do
    store = root |> record(streams(case), fn _ -> [keys: true] end) |> Store.open!()

    got =
      Map.new(case["expect"], fn {name, _} ->
        {:ok, %{"keys" => keys}} = Store.metadata(store, name)
        {name, keys}
      end)

    verdict(Map.new(case["expect"], fn {name, keys} -> {name, Enum.sort(keys)} end), got)
  end

  def run("dynamic_read", %{"written" => _}, _case, _root) do
    {:not_applicable, "Elixir's values are immutable: none can refer to itself"}
  end

  # Written with their types, read without.
  def run("dynamic_read", _params, %{"expect" => %{"values" => values}}, root) do
    streams =
      for {v, i} <- Enum.with_index(values),
          do: {"Data#{i}", [%Message{data: v, originating_time: 0}]}

    store = root |> record(streams) |> Store.open!()
    got = for {name, _} <- streams, {:ok, %{data: data}} = Store.at(store, name, 0), do: data
    verdict(values, got)
  end

  def run("dynamic_read", _params, case, root) do
    store = root |> record(streams(case)) |> Store.open!()
    [{first, _} | _] = streams(case)

    got =
      Map.new(case["expect"], fn {key, _} ->
        if Store.has_stream?(store, key),
          do: {key, plain(data(store, key))},
          else: {key, plain(hd(data(store, first)))}
      end)

    verdict(case["expect"], got)
  end

  def run("schema_evolution", params, case, root) do
    written = struct_module(params["written_members"], [])
    today = struct_module(params["read_members"], params["required"] || [])
    [members] = values(case, params)
    data = struct(written, for({name, v} <- members, do: {String.to_atom(name), v}))

    path =
      record(root, [{"data", [%Message{data: data, originating_time: 0}]}], fn _ ->
        [type: written]
      end)

    got =
      Pipeline.run(fn p ->
        p
        |> Store.importer(path)
        |> Store.stream("data", type: today)
        |> Situ.each(fn _ -> :ok end)
      end)

    case {got, case["expect_error"]} do
      {{:error, %{code: :schema_mismatch}}, error} when error != nil ->
        :pass

      {{:ok, _}, nil} ->
        [message] = path |> Store.open!() |> Store.messages("data", type: today) |> Enum.to_list()
        value = for {k, v} <- Map.from_struct(message.data), into: %{}, do: {to_string(k), v}
        verdict(case["expect"]["value"], value)

      {other, _} ->
        {:fail, case["expect"] || case["expect_error"], other}
    end
  end

  # Figures the case tells of streams by name.
  defp figures(case, infos) do
    told =
      for {name, %{} = wanted} <- case["expect"], info = find(infos, name), do: {wanted, info}

    wrong =
      for {wanted, info} <- told,
          {key, value} <- wanted,
          figure(info, key) != value,
          do: {info.name, key, figure(info, key)}

    if wrong == [], do: :pass, else: {:fail, case["expect"], wrong}
  end

  defp find(infos, name), do: Enum.find(infos, &(&1.name == name))

  defp figure(info, "count"), do: info.count
  defp figure(info, "closed"), do: StreamInfo.closed?(info)
  defp figure(info, "type"), do: info.type_name
  defp figure(info, "size"), do: info.size
  defp figure(info, "average_size"), do: StreamInfo.average_size(info)
  defp figure(info, "rate_hz"), do: StreamInfo.rate(info)
  defp figure(info, "first_ms"), do: info.first && div(info.first, ms())
  defp figure(info, "last_ms"), do: info.last && div(info.last, ms())
  defp figure(info, "closed_ms"), do: info.closed && div(info.closed, ms())
  defp figure(_info, other), do: raise(ArgumentError, "an unknown figure: #{other}")

  # A struct with these fields, as a program of that day would define it. New fields have defaults, unless they are required.
  defp struct_module(members, required) do
    name = Module.concat(Situ.Conformance.Store, "Struct#{:erlang.phash2({members, required})}")
    fields = for m <- members, do: {String.to_atom(m), default(m)}
    keys = Enum.map(required, &String.to_atom/1)

    if not Code.ensure_loaded?(name) do
      Module.create(
        name,
        quote do
          @enforce_keys unquote(keys)
          defstruct(unquote(Macro.escape(fields)))
        end,
        Macro.Env.location(__ENV__)
      )
    end

    name
  end

  defp default("Double" <> _), do: 0.0
  defp default("Int" <> _), do: 0
  defp default(_), do: nil

  defp values(case, params) do
    case streams(case) do
      [{_, [%{data: data} | _]} | _] -> [data]
      _ -> [Map.new(params["written_members"], &{&1, default(&1)})]
    end
  end
end
