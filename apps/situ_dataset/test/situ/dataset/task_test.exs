defmodule Situ.Dataset.TaskTest do
  use ExUnit.Case, async: true
  alias Situ.Dataset.Task

  doctest Situ.Dataset.Task

  test "finds a task by its name, and suggests a similar one" do
    assert Enum.map(Task.list_tasks(), & &1.task().name) |> Enum.sort() ==
             Enum.map(Task.list_tasks(), & &1.task().name)

    assert {:ok, Task.Statistics} = Task.fetch_task("statistics")

    assert {:error, %{code: :no_task, fix: "did you mean drop-streams?"}} =
             Task.fetch_task("drop-stream")
  end

  test "every task has a name, a summary and documented options" do
    for module <- Task.list_tasks(), task = module.task() do
      assert task.name =~ ~r/\A[a-z][a-z-]*\z/ and task.about != ""
      for {name, spec} <- task.options, do: assert(is_binary(spec[:doc]), "#{task.name}: #{name}")
    end
  end

  defmodule Above do
    @behaviour Task

    @impl true
    def task do
      %{
        name: "above",
        about: "where a number is above a threshold",
        output: "Above",
        options: [above: [type: :number, default: 2, doc: "The threshold."]]
      }
    end

    @impl true
    def build(_p, opts),
      do: opts[:open].("Level") |> Situ.map(&(&1 > opts[:above])) |> opts[:write].("Above")
  end

  @tag :tmp_dir
  test "a task runs with its defaults from a program", %{tmp_dir: folder} do
    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        store = Situ.Store.create(p, "room", Path.join(folder, "p01"))
        p |> Situ.from_enumerable(1..4, every: 1) |> Situ.Store.write(store, "Level")
      end)

    {:ok, dataset} = Situ.Dataset.open(folder)
    assert {:ok, dataset, report} = Situ.Dataset.derive(dataset, Above)
    assert [%{status: :done}] = report.results

    {:ok, above} =
      dataset.sessions
      |> hd()
      |> Situ.Dataset.OpenSession.open()
      |> Situ.Dataset.OpenSession.messages("Above")

    assert Enum.map(above, & &1.data) == [false, false, true, true]

    assert {:error, %{code: :bad_option}} =
             Situ.Dataset.derive(dataset, Above, options: [above: "high"])
  end
end
