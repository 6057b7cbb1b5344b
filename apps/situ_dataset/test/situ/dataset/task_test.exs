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
end
