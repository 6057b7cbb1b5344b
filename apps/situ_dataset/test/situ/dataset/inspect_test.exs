defmodule Situ.Dataset.InspectTest do
  use ExUnit.Case, async: true

  test "a dataset shows its name and how many sessions it has" do
    {:ok, dataset} = Situ.Dataset.new("Lobby")
    assert inspect(dataset) =~ ~s(#Situ.Dataset<"Lobby", 0 sessions)
    file = %{dataset | file: "/data/lobby.json"}
    assert inspect(file) == ~s(#Situ.Dataset<"Lobby", 0 sessions, "/data/lobby.json">)
  end
end
