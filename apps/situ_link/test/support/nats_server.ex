defmodule Situ.Test.NatsServer do
  @moduledoc false
  # A real nats-server for tests: a separate OS process that can be killed and restarted on the same data.
  alias Situ.Test.FreePort

  @doc "Returns its path, or `nil`; bin/setup --for test fetches it."
  @spec path() :: Path.t() | nil
  def path do
    fetched = Path.expand("../../priv/nats/nats-server", __DIR__)

    System.get_env("SITU_NATS_SERVER") || (File.exists?(fetched) && fetched) ||
      System.find_executable("nats-server")
  end

  @doc "Starts a server in `dir`; `settings` are lines of its configuration."
  @spec start(Path.t(), keyword()) :: map()
  def start(dir, opts \\ []) do
    port = opts[:port] || FreePort.find_tcp()
    File.mkdir_p!(dir)
    config = Path.join(dir, "server.conf")
    data = Path.join(dir, "data")

    File.write!(config, """
    listen: "127.0.0.1:#{port}"
    server_name: "#{opts[:name] || "n#{port}"}"
    #{if opts[:jetstream] != false, do: ~s(jetstream { store_dir: "#{data}" })}
    #{opts[:settings]}
    """)

    server = %{
      port: port,
      dir: dir,
      opts: Keyword.put(opts, :port, port),
      url: "nats://127.0.0.1:#{port}"
    }

    run(server)
  end

  @doc "Starts it again on the data it has kept."
  @spec run(map()) :: map()
  def run(server) do
    process =
      Port.open({:spawn_executable, path()}, [
        :binary,
        :exit_status,
        :stderr_to_stdout,
        cd: server.dir,
        args: ["-c", server[:config] || "server.conf"]
      ])

    {:os_pid, pid} = Port.info(process, :os_pid)
    wait(server.port, 600)
    Map.merge(server, %{process: process, pid: pid})
  end

  @spec kill(map()) :: map()
  def kill(server) do
    System.cmd("kill", ["-KILL", "#{server.pid}"], stderr_to_stdout: true)
    gone(server.pid, 600)
    server
  end

  defp wait(port, left) do
    case :gen_tcp.connect({127, 0, 0, 1}, port, [], 1_000) do
      {:ok, socket} ->
        :gen_tcp.close(socket)

      {:error, _} when left > 0 ->
        Process.sleep(50)
        wait(port, left - 1)
    end
  end

  defp gone(pid, left) do
    if left > 0 and File.exists?("/proc/#{pid}/exe") do
      Process.sleep(20)
      gone(pid, left - 1)
    end
  end
end
