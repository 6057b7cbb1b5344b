defmodule Situ.Conformance.Store.Making do
  # Stores made from stores: cut, copied, edited, repaired, merged, renamed and deleted.
  import Situ.Conformance.Case, only: [all: 2, meant: 3, verdict: 2]
  import Situ.Conformance.Store.Tape
  alias Situ.Store
  alias Situ.Store.Writer

  # An interval by times, or by a start and a length from the first message.
  def run("crop" <> _, params, case, root) do
    path = record(root, streams(case), &metadata(params, &1))

    options =
      for key <- ["from", "to", "start", "length"],
          value = time(params, key),
          do: {String.to_existing_atom(key), value}

    cropped = made!(Store.crop(path, {"cropped", root}, options))

    case case["expect"]["kept_values"] do
      nil -> by_stream(case, cropped)
      kept -> kept(case, cropped, kept)
    end
  end

  # The writing process has ended without closing the store.
  def run("repair", params, case, root) do
    crash = time(params, "simulated_crash_at") || :never
    [{name, messages} | _] = streams(case)
    before = Enum.filter(messages, &(&1.originating_time < crash))

    {:ok, path} =
      if crash == :never,
        do: {:ok, record(root, streams(case))},
        else: crashed(name, before, root)

    store = Store.open!(path)
    until(fn -> not Store.live?(store) end)
    closed_before = Store.closed?(store)
    {:ok, _} = Store.repair(path)
    repaired = Store.open!(path)
    got = Enum.to_list(Store.messages(repaired, name))

    prefix? = envelopes(got) == envelopes(Enum.take(messages, length(got)))
    limit = case["expect"]["nothing_at_or_after_ticks"]
    none? = limit == nil or Enum.all?(got, &(&1.originating_time < limit * 100))

    values =
      case case["expect"]["values"] do
        text when is_binary(text) -> meant(text, ~r/prefix|unchanged|same/, prefix?)
        _ -> Enum.map(got, & &1.data)
      end

    if envelopes(got) == envelopes(before),
      do:
        all(case, %{
          "closed_before" => closed_before,
          "readable_after" => Store.closed?(repaired),
          "closed_after" => Store.closed?(repaired),
          "count" => length(got),
          "nothing_at_or_after_ticks" => if(none?, do: limit, else: :later),
          "values" => values,
          name => Enum.map(got, & &1.data)
        }),
      else: {:fail, envelopes(before), envelopes(got)}
  end

  # Edits of one stream, or of several by name. Messages without edits stay unchanged.
  def run("edit" <> _, params, case, root) do
    path = record(root, streams(case), &metadata(params, &1))
    [first | _] = Enum.map(case["inputs"], & &1["stream"])
    stream = params["stream"] || params["edited_stream"] || first

    edits =
      case params["edits"] do
        %{} = named -> Map.new(named, fn {name, list} -> {name, Enum.map(list, &edit/1)} end)
        list -> %{stream => Enum.map(list, &edit/1)}
      end

    new = made!(Store.edit(path, {"edited", root}, edits))
    by_stream(case, new, &unedited?(Store.open!(path), new, &1, edits))
  end

  # The entire store, a span of it, or some of its streams, with their envelopes, types and
  # metadata.
  def run("copy" <> _, params, case, root) do
    streams = streams(case)
    path = record(root, streams, &metadata(params, &1))
    {from, to} = bounds(params)
    span = if from, do: [from: from, to: to], else: []
    names = if params["streams"], do: [streams: params["streams"]], else: []
    new = made!(Store.copy(path, {"copied", root}, span ++ names))
    old = Store.open!(path)

    kept? = &(from == nil or (&1.originating_time >= from and &1.originating_time <= to))

    same? =
      Enum.all?(Store.streams(new), fn %{name: name} ->
        Enum.map(Enum.filter(Store.messages(old, name), kept?), &%{&1 | source_id: nil}) ==
          Enum.map(Store.messages(new, name), &%{&1 | source_id: nil})
      end)

    if same?,
      do: by_stream(case, new, fn _stream -> true end),
      else: {:fail, "the same messages", "others"}
  end

  # The store is deleted from the disk, and nothing else.
  def run("delete", _params, case, root) do
    path = record(root, streams(case))
    kept = record(root, streams(case), fn _ -> [] end, "other")
    true = Store.exists?(path)
    :ok = Store.delete(path)
    verdict({false, true}, {Store.exists?(path), Store.exists?(kept)})
  end

  # Recordings with the same name get versions. The name refers to the newest, and a rename
  # changes it.
  def run("versions", _params, case, root) do
    paths = for _ <- 1..2, do: record(root, streams(case), fn _ -> [] end, "walk")
    {:ok, renamed} = Store.rename(hd(paths), "stroll")

    got = %{
      "folders" => Enum.map(paths ++ [renamed], &Path.basename/1),
      "newest" => Path.basename(Store.open!(Path.join(root, "walk")).path),
      "exists" => Enum.map(["walk", "stroll", "run"], &Store.exists?(Path.join(root, &1))),
      "listed" => Enum.map(Store.list(root), &Path.basename/1)
    }

    verdict(case["expect"], got)
  end

  def run("add_stream", params, case, root) do
    [{name, _} | _] = streams = streams(case)
    path = record(root, streams)
    meta = params["supplemental_metadata"]

    new =
      made!(
        Store.edit(path, {"added", root}, %{}, add: [{params["new_stream"], [metadata: meta]}])
      )

    old = Store.open!(path)

    all(
      case,
      %{
        name => data(new, name),
        params["new_stream"] => data(new, params["new_stream"]),
        "supplemental_metadata" => elem(Store.metadata(new, params["new_stream"]), 1),
        "envelopes" =>
          if(Enum.to_list(Store.messages(old, name)) == Enum.to_list(Store.messages(new, name)),
            do: "unchanged",
            else: "changed"
          )
      }
    )
  end

  # Inputs have names like STORE/STREAM.
  def run("concatenate", params, case, root) do
    types = params["types"] || %{}

    parts =
      case
      |> streams()
      |> Enum.group_by(fn {name, _} -> name |> String.split("/") |> hd() end)
      |> Enum.sort()
      |> Enum.map(fn {store, streams} ->
        streams =
          for {name, messages} <- streams,
              do: {name |> String.split("/") |> List.last(), messages}

        options = if type = types[store], do: [type: String.to_existing_atom(type)], else: []
        record(root, streams, fn _ -> options end, store)
      end)

    store = made!(Store.concat(parts, {"whole", root}))

    if case["expect_error"],
      do: {:fail, {:error, case["expect_error"]}, store.path},
      else:
        verdict(
          case["expect"],
          Map.new(case["expect"], fn {name, _} -> {name, data(store, name)} end)
        )
  end

  # One value for every stream, or values by the stream's name.
  defp metadata(%{"supplemental_metadata" => %{} = by_name}, name),
    do: if(value = by_name[name], do: [metadata: value], else: [])

  defp metadata(%{"supplemental_metadata" => value}, _name) when value != nil,
    do: [metadata: value]

  defp metadata(_params, _name), do: []

  # Compares the messages of a stream (or of all) at times without an edit, with their envelopes.
  defp unedited?(old, new, :all, edits),
    do: Enum.all?(Store.streams(old), &unedited?(old, new, &1.name, edits))

  defp unedited?(old, new, name, edits) do
    times = for edit <- edits[name] || [], do: elem(edit, 1)

    rest = fn store ->
      for m <- Store.messages(store, name),
          m.originating_time not in times,
          do: %{m | source_id: nil}
    end

    rest.(old) == rest.(new)
  end

  defp made!({:ok, path}), do: Store.open!(path)
  defp made!({:error, error}), do: raise(error)

  defp kept(case, store, kept) do
    got =
      for {name, [%{data: first} | _]} <- streams(case) do
        messages = Enum.to_list(Store.messages(store, name))
        wanted = if is_binary(first), do: Enum.map(kept, &to_string/1), else: kept
        {Enum.map(messages, & &1.data) == wanted, Enum.map(messages, & &1.sequence_id) == kept}
      end

    all(case, %{
      "kept_values" => if(Enum.all?(got, &elem(&1, 0)), do: kept, else: got),
      "sequence_id" =>
        meant(
          case["expect"]["sequence_id"],
          ~r/equals?|same|unchanged|value/,
          Enum.all?(got, &elem(&1, 1))
        )
    })
  end

  defp crashed(name, messages, root) do
    {pid, monitor} =
      spawn_monitor(fn ->
        {:ok, writer} = Writer.create("crashed", root)
        {:ok, stream} = Writer.stream(writer, name)

        Enum.reduce(messages, stream, fn message, stream ->
          elem(Writer.append(stream, [message]), 1)
        end)
      end)

    receive do: ({:DOWN, ^monitor, :process, ^pid, reason} -> :normal = reason)
    {:ok, Path.join(root, "crashed")}
  end

  defp edit(%{"delete" => _} = e), do: {:delete, Situ.Conformance.Case.time(e)}
  defp edit(%{"upsert" => nil} = e), do: {:delete, Situ.Conformance.Case.time(e)}
  defp edit(%{"upsert" => value} = e), do: {:upsert, Situ.Conformance.Case.time(e), value}
end
