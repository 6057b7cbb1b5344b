defmodule Situ.Store.S3.Client do
  @moduledoc false
  # Owns the program object_port, which sends the requests to object storage, and passes replies to the callers. The
  # program is started at the first request. If it crashes, all requests in flight fail, and the next request starts it
  # again. `ports/object_port/src/main.rs` describes the frames.
  # See docs/adr/0105-large-libraries-run-in-separate-programs.md.
  use GenServer
  alias Situ.Error
  alias Situ.Store.S3.{Cost, Program}

  @done 0
  @failed 1
  @progress 2

  @type reply :: {map(), binary()}

  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(opts), do: GenServer.start_link(__MODULE__, nil, name: opts[:name] || __MODULE__)

  @doc """
  Runs a command of object_port and returns its reply. Calls `progress` with the number of bytes of each finished part.
  The costs of the command are added to the caller's (`Situ.Store.S3.Cost`).
  """
  @spec request(map(), iodata(), (non_neg_integer() -> any())) ::
          {:ok, reply()} | {:error, Error.t()}
  def request(command, bytes \\ "", progress \\ fn _ -> :ok end) do
    tag = make_ref()

    with {:ok, pid} <- find_server(),
         monitor = Process.monitor(pid),
         :ok <- GenServer.call(pid, {:request, self(), tag, command, bytes}, :infinity) do
      await_reply(tag, monitor, command, progress)
    end
  catch
    :exit, _ -> {:error, ended_error("it was stopped")}
  end

  defp find_server do
    case GenServer.whereis(__MODULE__) || start_application() do
      pid when is_pid(pid) -> {:ok, pid}
      nil -> {:error, ended_error("the application :situ_store is not running")}
    end
  end

  defp start_application do
    _ = Application.ensure_all_started(:situ_store)
    GenServer.whereis(__MODULE__)
  end

  defp await_reply(tag, monitor, command, progress) do
    receive do
      {^tag, @progress, %{"done" => bytes}, _} ->
        progress.(bytes)
        await_reply(tag, monitor, command, progress)

      {^tag, kind, value, bytes} ->
        Process.demonitor(monitor, [:flush])
        Cost.add(value["cost"])
        if kind == @done, do: {:ok, {value, bytes}}, else: {:error, to_error(value, command)}

      {^tag, :ended, why} ->
        Process.demonitor(monitor, [:flush])
        {:error, ended_error(why)}

      {:DOWN, ^monitor, _, _, _} ->
        {:error, ended_error("its supervisor stopped it")}
    end
  end

  @impl true
  def init(nil), do: {:ok, %{port: nil, next: 0, waiting: %{}}}

  @impl true
  def handle_call({:request, pid, tag, command, bytes}, _from, state) do
    case ensure_port(state) do
      {:ok, state} ->
        text = Situ.JSON.encode(command)
        frame = [<<state.next::64, IO.iodata_length(text)::32>>, text, bytes]
        waiting = Map.put(state.waiting, state.next, {pid, tag})

        if send_frame(state.port, frame),
          do: {:reply, :ok, %{state | next: state.next + 1, waiting: waiting}},
          else: {:reply, {:error, ended_error("it has just ended")}, state}

      {:error, error} ->
        {:reply, {:error, error}, state}
    end
  end

  defp ensure_port(%{port: nil} = state) do
    with {:ok, program} <- Program.fetch_path() do
      options = [:binary, :exit_status, packet: 4]
      {:ok, %{state | port: Port.open({:spawn_executable, program}, options)}}
    end
  end

  defp ensure_port(state), do: {:ok, state}

  # The program may have exited already, while its last message is in flight.
  defp send_frame(port, frame) do
    Port.command(port, frame)
  rescue
    ArgumentError -> false
  end

  @impl true
  def handle_info({port, {:data, frame}}, %{port: port} = state) do
    with <<id::64, kind, size::32, text::binary-size(size), bytes::binary>> <- frame,
         %{^id => {pid, tag}} <- state.waiting,
         {:ok, value} <- Situ.JSON.decode(text) do
      send(pid, {tag, kind, value, bytes})

      waiting =
        if kind in [@done, @failed], do: Map.delete(state.waiting, id), else: state.waiting

      {:noreply, %{state | waiting: waiting}}
    else
      _ -> {:noreply, state}
    end
  end

  def handle_info({port, {:exit_status, status}}, %{port: port} = state) do
    for {_, {pid, tag}} <- state.waiting, do: send(pid, {tag, :ended, "exit status #{status}"})
    {:noreply, %{state | port: nil, waiting: %{}}}
  end

  def handle_info(_other, state), do: {:noreply, state}

  defp ended_error(why) do
    Error.new(:object_port_ended, "the program object_port ended during a request",
      why: why,
      fix: "run this again; it continues where it stopped"
    )
  end

  @fixes %{
    "credentials" =>
      {:no_credentials, "set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or AWS_PROFILE"},
    "denied" =>
      {:not_permitted,
       "check the credentials (AWS_PROFILE, AWS_ACCESS_KEY_ID) and their permissions"},
    "not_found" => {:not_found, "`situ store list s3://BUCKET/PREFIX` lists the recordings"},
    "changed" => {:store_replaced, "open the recording again"},
    "checksum" =>
      {:damaged, "run this again; if it happens again, the object or the network is damaged"},
    "local" => {:io, "check the folder and its free space"},
    "invalid" => {:bad_request, nil}
  }

  defp to_error(%{"code" => code, "why" => why}, command) do
    {reason, fix} =
      Map.get(@fixes, code, {:unreachable, "check AWS_ENDPOINT_URL, AWS_REGION and the network"})

    Error.new(reason, "cannot #{describe_command(command)}", why: why, fix: fix)
  end

  defp describe_command(%{op: "list"} = command),
    do: "list s3://#{command.bucket}/#{command.prefix}"

  defp describe_command(%{op: "sums", path: path}), do: "read #{path}"
  defp describe_command(%{op: "delete", bucket: bucket}), do: "delete objects of s3://#{bucket}"

  defp describe_command(%{op: op, bucket: bucket, key: key}) when op in ["put", "upload"],
    do: "write s3://#{bucket}/#{key}"

  defp describe_command(%{bucket: bucket, key: key}), do: "read s3://#{bucket}/#{key}"
  defp describe_command(_command), do: "use object storage"
end
