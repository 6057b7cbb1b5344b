defmodule Situ.Store.FileLockTest do
  use ExUnit.Case, async: true
  alias Situ.Store.FileLock
  doctest FileLock

  @moduletag :tmp_dir

  setup context do
    if root = context[:tmp_dir], do: %{path: Path.join(root, "x.lock")}, else: :ok
  end

  test "a lock is released when its process ends, even if it is killed", %{path: path} do
    parent = self()

    for _ <- 1..20 do
      holder =
        spawn(fn ->
          {:ok, lock} = FileLock.acquire(path)
          send(parent, {:held, self(), lock})
          receive do: (:never -> FileLock.release(lock))
        end)

      # The lock's term stays alive in this process; only the owner process counts.
      assert_receive {:held, ^holder, _lock}
      assert {:held, told} = FileLock.acquire(path)
      assert told.process == holder |> :erlang.pid_to_list() |> to_string()
      monitor = Process.monitor(holder)
      Process.exit(holder, :kill)
      assert_receive {:DOWN, ^monitor, _, _, _}
      assert {:ok, lock} = FileLock.acquire(path)
      FileLock.release(lock)
    end

    refute File.exists?(path)
  end

  test "a lock can be transferred to another process", %{path: path} do
    parent = self()

    taker =
      spawn_link(fn ->
        {:ok, lock} = FileLock.acquire(path)
        send(parent, {:lock, lock})
      end)

    assert_receive {:lock, lock}
    monitor = Process.monitor(taker)
    assert_receive {:DOWN, ^monitor, _, _, _}
    assert {:ok, mine} = FileLock.acquire(path)

    owner =
      spawn(fn ->
        receive do: (:own -> FileLock.take_ownership(mine))
        send(parent, :owned)
        receive do: (:stop -> :ok)
      end)

    send(owner, :own)
    assert_receive :owned
    assert {:held, _} = FileLock.acquire(path)
    FileLock.release(lock)
    assert {:held, _} = FileLock.acquire(path)
    monitor = Process.monitor(owner)
    send(owner, :stop)
    assert_receive {:DOWN, ^monitor, _, _, _}
    assert {:ok, _} = FileLock.acquire(path, 5_000)
  end

  test "another program's lock is respected, awaited, and released when that program ends", ctx do
    File.write!(
      ctx.path,
      ~s({"os_pid": "4711", "host": "lab\\u001b[2J", "program": "situ studio"})
    )

    program =
      Port.open({:spawn_executable, System.find_executable("flock")}, [
        :binary,
        args: [ctx.path, "sh", "-c", "echo held; read line"]
      ])

    assert_receive {^program, {:data, "held" <> _}}, 10_000
    assert {:held, holder} = FileLock.acquire(ctx.path)
    assert FileLock.describe_holder(holder) =~ "situ studio (process 4711 on lab?[2J)"
    waiting = Task.async(fn -> elem(FileLock.acquire(ctx.path, 60_000), 0) end)
    Port.command(program, "go\n")
    assert Task.await(waiting, 60_000) == :ok
  end

  test "returns an error if a lock cannot be created, and does not follow links", %{path: path} do
    assert {:error, %Situ.Error{}} = FileLock.acquire(Path.join(path, "nowhere"))
    File.ln_s!(path <> ".target", path)
    assert {:error, %Situ.Error{}} = FileLock.acquire(path)
    refute File.exists?(path <> ".target")
  end
end
