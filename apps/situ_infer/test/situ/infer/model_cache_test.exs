defmodule Situ.Infer.ModelCacheTest do
  use ExUnit.Case, async: true
  import Situ.Test.Eventually
  alias Situ.Infer.ModelCache

  setup context do
    {:ok, cache} = ModelCache.start_link([name: nil] ++ Map.get(context, :cache, []))
    %{cache: cache}
  end

  # A process that asks for `key` and then lives until it is stopped.
  defp user(cache, key, size, load) do
    test = self()

    spawn_link(fn ->
      send(test, {self(), ModelCache.fetch(cache, key, size, load)})
      receive do: (:stop -> :ok)
    end)
  end

  defp stop(user) do
    ref = Process.monitor(user)
    send(user, :stop)
    assert_receive {:DOWN, ^ref, _, _, _}
  end

  defp kept?(cache, key), do: key in ModelCache.list_keys(cache)

  test "concurrent requests share one load and do not block other models", %{cache: cache} do
    test = self()

    slow = fn ->
      send(test, {:loading, self()})
      receive do: (:go -> {:ok, make_ref()})
    end

    users = for _ <- 1..3, do: user(cache, :slow, 1, slow)
    assert_receive {:loading, loader}
    assert ModelCache.fetch(cache, :quick, 1, fn -> {:ok, :quick} end) == {:ok, :quick}
    refute_received {_, {:ok, _}}
    send(loader, :go)
    results = for user <- users, do: assert_receive({^user, result}) && result
    assert [_one] = results |> Enum.map(fn {_, result} -> result end) |> Enum.uniq()
    refute_received {:loading, _}
  end

  test "a failed load is retried on the next request, and a crash is an error", %{cache: cache} do
    error = Situ.Error.new(:no_model_file, "no such file")
    assert ModelCache.fetch(cache, :a, 1, fn -> {:error, error} end) == {:error, error}
    assert {:error, %RuntimeError{}} = ModelCache.fetch(cache, :a, 1, fn -> raise "no" end)
    killed = fn -> Process.exit(self(), :kill) end
    assert {:error, %{code: :bad_model}} = ModelCache.fetch(cache, :a, 1, killed)
    assert ModelCache.fetch(cache, :a, 1, fn -> {:ok, 1} end) == {:ok, 1}
  end

  @tag cache: [keep_ms: 0]
  test "a model is unloaded when the last of its users has ended", %{cache: cache} do
    [a, b] = for _ <- 1..2, do: user(cache, :model, 1, fn -> {:ok, :model} end)
    assert_receive {^a, {:ok, :model}}
    assert_receive {^b, {:ok, :model}}
    stop(a)
    assert kept?(cache, :model)
    stop(b)
    assert eventually(fn -> not kept?(cache, :model) end)
  end

  @tag cache: [bytes: 10]
  test "beyond the budget, the least recently requested model is unloaded", %{cache: cache} do
    load = fn -> {:ok, :model} end
    for key <- [:a, :b], do: {:ok, _} = ModelCache.fetch(cache, key, 5, load)
    {:ok, _} = ModelCache.fetch(cache, :a, 5, load)
    {:ok, _} = ModelCache.fetch(cache, :c, 5, load)
    assert ModelCache.list_keys(cache) == [:c, :a]
    {:ok, _} = ModelCache.fetch(cache, :huge, 50, load)
    assert ModelCache.list_keys(cache) == [:huge]
  end
end
