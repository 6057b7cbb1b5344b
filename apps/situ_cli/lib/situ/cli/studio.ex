defmodule Situ.CLI.Studio do
  @moduledoc "`situ studio`: recordings in the browser."
  @behaviour Situ.CLI.Command

  alias Situ.{Error, Studio}

  @switches [
    port: :integer,
    listen: :string,
    token: :string,
    layouts: :string,
    read_only: :boolean,
    open: :boolean
  ]

  @impl true
  def name, do: "studio"

  @impl true
  def summary, do: "look at recordings in the browser: scrub, play, watch live"

  @impl true
  def usage do
    """
    Usage: situ studio [STORE | FOLDER] [OPTIONS]

    Serves the studio until it is stopped (Ctrl-C) and opens the browser. STORE is a recording; FOLDER holds
    recordings at any depth; default: the folder "recordings", else this one. A recording that is being written is
    followed live.

      --port N          listen on port N (default 4040; 0 takes a free one)
      --listen ADDRESS  listen on this address (default 127.0.0.1); elsewhere a browser must bring a token
      --token TEXT      the token (8 characters or more) in place of a random one
      --layouts FOLDER  where layouts are saved (default: the user's configuration folder)
      --read-only       nothing on disk can be changed
      --no-open         do not open the browser

    Exit status: 0 stopped, 1 could not start, 2 wrong usage.

    Example: situ studio recordings/lobby --port 4041
    """
  end

  @impl true
  def run(argv) do
    case OptionParser.parse(argv, strict: @switches) do
      {opts, paths, []} when length(paths) <= 1 -> serve(List.first(paths), opts)
      {_, _, [{switch, _} | _]} -> wrong("unknown or incomplete option #{switch}")
      {_, [_, extra | _], _} -> wrong("one recording or folder at a time, not also #{extra}")
    end
  end

  defp wrong(text) do
    IO.puts(:stderr, "situ studio: #{text}\n  Fix: see `situ studio --help`")
    2
  end

  defp serve(path, opts) do
    {:ok, _} = Application.ensure_all_started(:situ_studio)
    path = path || if(File.dir?("recordings"), do: "recordings", else: ".")

    with :ok <- check_path(path),
         {:ok, ip} <- address(opts[:listen] || "127.0.0.1"),
         {:ok, studio} <- start(path, ip, opts) do
      url = Studio.url(studio, Studio.only_item(studio))
      IO.puts("Situ Studio shows #{path} at #{url}")
      if Keyword.get(opts, :open, true), do: open(url)
      wait(studio)
    else
      {:error, error} -> raise error
    end
  end

  defp check_path(path) do
    if File.exists?(path) do
      :ok
    else
      {:error,
       Error.new(:not_found, "there is nothing at #{path}",
         fix: "name a recording, or a folder that holds some"
       )}
    end
  end

  defp address(text) do
    case text |> String.to_charlist() |> :inet.parse_address() do
      {:ok, ip} ->
        {:ok, ip}

      {:error, _} ->
        {:error,
         Error.new(:bad_address, "not an address: #{inspect(text)}",
           fix: "write it like 0.0.0.0 or ::1"
         )}
    end
  end

  defp start(path, ip, opts) do
    Process.flag(:trap_exit, true)

    Studio.start_link(
      [path: path, ip: ip, port: opts[:port] || 4040, read_only: opts[:read_only] || false] ++
        if(opts[:token], do: [token: opts[:token]], else: []) ++
        if(opts[:layouts], do: [layouts: opts[:layouts]], else: [])
    )
  end

  # The desktop's own way to open an address; where there is no desktop, the printed address is all there is.
  defp open(url) do
    desktop? = System.get_env("DISPLAY") || System.get_env("WAYLAND_DISPLAY")
    opener = desktop? && (System.find_executable("xdg-open") || System.find_executable("open"))
    if opener, do: Task.start(fn -> System.cmd(opener, [url], stderr_to_stdout: true) end)
    :ok
  end

  defp wait(studio) do
    receive do
      {:EXIT, ^studio, reason} ->
        IO.puts(:stderr, "situ studio: the studio ended: #{inspect(reason)}")
        1
    end
  end
end
