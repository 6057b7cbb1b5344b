defmodule Situ.Bridge.Parquet.Program do
  @moduledoc false
  # The program native/situ_parquet, which reads or writes one Parquet file. It is a separate program, because a
  # hostile file can make the crate `parquet` panic, recurse until the stack overflows, or allocate much memory.
  # Requests and results are terms. See docs/adr/0200-parquet-files-are-read-by-a-program.md.
  alias Situ.Error

  # A request reads or writes some rows, or a row group.
  @timeout_ms 120_000
  @max_packet 0x7FFFFFFF

  # The atoms of results. Decoding creates no atoms, so they must exist.
  @atoms [:ok, :done, :error, :malformed, :io, :disk_full, :nan, :infinity, :neg_infinity] ++
           [:integer, :float, :boolean]

  @type t :: port()

  @doc "Returns the atoms that results contain."
  @spec list_atoms() :: [atom()]
  def list_atoms, do: @atoms

  @doc "Starts the program. Raises `Situ.Error` `:not_built` if it does not exist."
  @spec start_program() :: t()
  def start_program do
    path = Path.join(:code.priv_dir(:situ_bridge), "native/situ_parquet")

    unless Elixir.File.exists?(path) do
      raise Error.new(:not_built, "Parquet files cannot be read or written",
              why: "the program #{path} does not exist",
              fix: "run bin/setup"
            )
    end

    Port.open({:spawn_executable, path}, [:binary, :exit_status, packet: 4])
  end

  @doc "Starts the program, calls `fun`, and stops the program."
  @spec with_program((t() -> result)) :: result when result: term()
  def with_program(fun) do
    program = start_program()

    try do
      fun.(program)
    after
      stop_program(program)
    end
  end

  @doc """
  Sends a request and returns the result. `path` is the file, for errors: `:io`, `:disk_full`; `:not_parquet` if the
  file is not a Parquet file, is damaged, or needs a feature that is not supported; `:not_writable`.
  """
  @spec call(t(), Path.t(), tuple()) :: {:ok, term()} | {:error, Error.t()}
  def call(program, path, request) do
    bytes = :erlang.term_to_binary(request)

    if byte_size(bytes) > @max_packet,
      do: {:error, call_error(request, path, "a row group has more than 2 GB; write fewer rows")},
      else: send_request(program, path, request, bytes)
  end

  defp send_request(program, path, request, bytes) do
    send(program, {self(), {:command, bytes}})

    receive do
      {^program, {:data, bytes}} ->
        bytes |> :erlang.binary_to_term([:safe]) |> decode_result(path, request)

      {^program, {:exit_status, status}} ->
        {:error, call_error(request, path, describe_status(status))}
    after
      @timeout_ms ->
        kill_program(program)

        {:error,
         call_error(request, path, "some rows take more than #{div(@timeout_ms, 1_000)} s")}
    end
  end

  @doc "Like `call/3`, but raises errors."
  @spec call!(t(), Path.t(), tuple()) :: term()
  def call!(program, path, request), do: program |> call(path, request) |> Error.unwrap!()

  defp decode_result({:error, {:malformed, why}}, path, request),
    do: {:error, call_error(request, path, why)}

  defp decode_result({:error, {code, why}}, path, request) do
    verb = if write_request?(request), do: "write", else: "read"
    {:error, Error.new(code, "cannot #{verb} #{path}", why: why)}
  end

  defp decode_result(result, _path, _request), do: {:ok, result}

  defp call_error(request, path, why) do
    if write_request?(request),
      do: Error.new(:not_writable, "#{path} cannot be written as Parquet", why: why),
      else: Error.new(:not_parquet, "#{path} cannot be read as Parquet", why: why)
  end

  defp write_request?(request), do: elem(request, 0) in [:create, :write, :finish]

  # A signal ends the program if an allocation exceeds the limit, or if the stack overflows.
  defp describe_status(status) when status in [134, 139],
    do: "its schema is nested too deeply, or it needs more than 6 GB of memory"

  defp describe_status(status), do: "the program ended with status #{status}"

  defp kill_program(program) do
    with {:os_pid, pid} <- Port.info(program, :os_pid),
         do: System.cmd("kill", ["-9", "#{pid}"], stderr_to_stdout: true)
  end

  @doc "Stops the program."
  @spec stop_program(t()) :: :ok
  def stop_program(program) do
    Process.unlink(program)
    if Port.info(program) != nil, do: Port.close(program)
    :ok
  rescue
    # The program ended in the meantime.
    ArgumentError -> :ok
  after
    discard_messages(program)
  end

  defp discard_messages(program) do
    receive do
      {^program, _} -> discard_messages(program)
      {:EXIT, ^program, _} -> discard_messages(program)
    after
      0 -> :ok
    end
  end
end
