defmodule Situ.Studio.Web.ExportDialogTest do
  # The page saves a part of a recording as a new recording.
  use ExUnit.Case, async: true
  import Situ.Test.Eventually

  alias Situ.Live.Test, as: Page
  alias Situ.Studio.{Catalog, History, Link, Recordings}
  alias Situ.Studio.Web.MainView

  @moduletag :tmp_dir

  setup %{tmp_dir: dir} do
    folder = Path.join(dir, "recordings")
    {:ok, writer} = Situ.Store.Writer.create("talk", folder)

    for {name, type} <- [{"Level", :float}, {"On", :boolean}], reduce: writer do
      writer ->
        {:ok, out} = Situ.Store.Writer.stream(writer, name, type: type)

        messages =
          for i <- 0..99 do
            data = if type == :float, do: i * 1.0, else: rem(i, 2) == 0
            t = i * 1_000
            %Situ.Message{data: data, originating_time: t, creation_time: t, sequence_id: i}
          end

        {:ok, out} = Situ.Store.Writer.append(out, messages)
        {:ok, _} = Situ.Store.Writer.close_stream(out, 99_000)
        writer
    end

    :ok = Situ.Store.Writer.close(writer)
    %{folder: folder}
  end

  defp studio(folder, opts \\ []) do
    id = "export-#{System.unique_integer([:positive])}"
    opts = [id: id, path: folder, layouts: folder] ++ opts

    start_supervised!(
      {DynamicSupervisor, name: Catalog.watch_supervisor(id), strategy: :one_for_one},
      id: :w
    )

    start_supervised!({Catalog, opts}, id: :export_catalog)
    session = %{"studio" => id}
    Page.mount(MainView, path: "/s/x", params: %{"id" => ["talk.0000"]}, session: session)
  end

  @part %{"from" => "10000", "to" => "19000", "of" => "selection"}

  # A separate process writes the recording and notifies the page.
  defp saved(page) do
    eventually(fn ->
      Enum.find(Page.take_pushed_events(page, "toast"), &(&1["text"] =~ "Saved as"))
    end)
  end

  test "saves the interval of all streams next to the recording", %{folder: folder} do
    page = studio(folder)
    Page.send_event(page, "export_dialog", @part)
    assert Page.text(page, "#export-save") =~ "9.00 us"
    Page.submit(page, "#export-save", %{"name" => "start", "streams" => "all"})
    assert %{"text" => text} = saved(page)
    assert text =~ Path.join(folder, "start.0000")
    {:ok, store} = Situ.Store.open(Path.join(folder, "start.0000"))

    assert store
           |> Situ.Store.streams()
           |> Enum.map(&{&1.name, &1.count, &1.first, &1.last})
           |> Enum.sort() ==
             [{"Level", 10, 10_000, 19_000}, {"On", 10, 10_000, 19_000}]

    assert Page.text(page, ".stores") =~ "start.0000"
  end

  test "saves only the streams that are shown", %{folder: folder} do
    page = studio(folder)
    Page.send_event(page, "remove_panel", %{"id" => "p1"})
    {:ok, layout} = page |> Page.get_attribute("#studio", "data-edit") |> Link.decode()
    [%{vis: [%{stream: shown}]}] = layout.panels
    Page.send_event(page, "export_dialog", @part)
    Page.submit(page, "#export-save", %{"name" => "start", "streams" => "shown"})
    assert saved(page)
    {:ok, store} = Situ.Store.open(Path.join(folder, "start.0000"))
    assert Enum.map(Situ.Store.streams(store), & &1.name) == [shown]
  end

  test "reports invalid requests, and writes nothing", %{folder: folder} do
    page = studio(folder)

    for {part, name} <- [
          {@part, "../out"},
          {@part, ""},
          {@part, "a/b"},
          {%{@part | "to" => "10000"}, "good"}
        ] do
      Page.send_event(page, "export_dialog", part)
      Page.submit(page, "#export-save", %{"name" => name, "streams" => "all"})
      assert [%{"text" => text}] = Page.take_pushed_events(page, "toast")
      assert text =~ "Fix:" or text =~ "cannot be"
    end

    Page.send_event(page, "export_dialog", %{@part | "from" => "x"})
    assert File.ls!(folder) == ["talk.0000"]
  end

  test "is not offered in a read-only studio or for streams in memory", context do
    page = studio(context.folder, read_only: true)
    Page.send_event(page, "export_dialog", @part)
    refute Page.has_element?(page, "#export-save")
    refute Page.render(page) =~ "as a recording (Ctrl"
    id = "memory-#{System.unique_integer([:positive])}"
    sources = %{"one" => Recordings.History.wrap(History.new(live: false))}
    start_supervised!({Catalog, id: id, sources: sources, layouts: context.folder}, id: :memory)
    session = %{"studio" => id}
    page = Page.mount(MainView, path: "/s/one", params: %{"id" => ["one"]}, session: session)
    Page.send_event(page, "export_dialog", @part)
    refute Page.has_element?(page, "#export-save")
  end
end
