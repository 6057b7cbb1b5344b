defmodule Situ.CLI.Studio do
  @moduledoc false
  # `situ studio`: shows recordings in the browser.
  @behaviour Situ.CLI.Verb

  alias Situ.CLI.{Interrupt, Option, Output, Plugin, Token, Verb}
  alias Situ.{Error, Studio}

  @impl true
  def verbs do
    [
      %Verb{
        words: ["studio"],
        summary: "view recordings in the browser: scrub, play, watch live",
        about: """
        Serves the studio until it is stopped (Ctrl-C) and opens the browser. PATH is a recording, or a folder that
        contains recordings at any depth (default: the folder "recordings", else the current folder). A recording that
        is being written is shown live.
        """,
        arguments: [
          path: [kind: :recording, optional: true, doc: "a recording, or a folder of recordings"]
        ],
        options: [
          Option.new(:port, :integer, "listen on this port; 0 selects a free one", default: 4040),
          Option.new(
            :listen,
            :string,
            "listen on this address; other addresses than the default require a token",
            value: "ADDRESS",
            default: "127.0.0.1"
          ),
          Token.token_option(
            "the file with the token (8 characters or more), or set SITU_TOKEN; default: a random token"
          ),
          Option.new(
            :token,
            :string,
            "the token itself; every user of the machine can read it"
          ),
          Option.new(:tls, :flag, "use HTTPS with a certificate generated for this machine"),
          Option.new(:certificate, :path, "use HTTPS with this certificate (PEM)"),
          Option.new(:key, :path, "the certificate's key (PEM)"),
          Option.new(
            :layouts,
            :path,
            "the folder for layouts (default: the user's configuration folder)"
          ),
          Option.new(
            :plugins,
            :path,
            "a plug-in, or a folder of plug-ins; see `situ plugin --help`",
            many?: true
          ),
          Option.new(
            :tiles,
            :string,
            "map tiles: https://.../{z}/{x}/{y}.png, or a folder of such files",
            value: "URL"
          ),
          Option.new(:tiles_credit, :string, "the attribution of the tiles, shown on the map",
            value: "TEXT"
          ),
          Option.new(
            :prefix,
            :string,
            "the path under which a proxy on this machine serves the studio, such as /situ",
            value: "PATH"
          ),
          Option.new(
            :public,
            :string,
            "the address under which a proxy with another host name serves the studio",
            value: "URL"
          ),
          Option.new(:read_only, :flag, "do not allow changes to files"),
          Option.new(:open, :flag, "do not open the browser", negated?: true)
        ],
        examples: ["situ studio recordings/lobby --port 4041"],
        run: fn %{path: path}, opts -> serve_studio(path, opts) end
      }
    ]
  end

  defp serve_studio(path, opts) do
    # Recordings of other systems can be shown as well.
    for app <- [:situ_bridge, :situ_link, :situ_studio],
        do: {:ok, _} = Application.ensure_all_started(app)

    path = path || if(File.dir?("recordings"), do: "recordings", else: ".")

    with :ok <- check_path(path),
         {:ok, ip} <- parse_address(opts[:listen]),
         {:ok, tls} <- tls_settings(opts),
         {:ok, token} <- Token.read_token(opts),
         {:ok, studio} <- start_studio(path, ip, [tls: tls, secret: token] ++ opts) do
      url = Studio.url(studio, Studio.only_item(studio))
      Output.puts("Situ Studio shows #{path} at #{url}")
      if opts[:open], do: Situ.CLI.Desktop.open_url(url)
      wait_for_exit(studio)
    else
      {:error, error} -> raise error
    end
  end

  defp check_path(path) do
    # The name of a recording without a version is not a file.
    if File.exists?(path) or Situ.Store.exists?(path) do
      :ok
    else
      {:error,
       Error.new(:not_found, "#{path} does not exist",
         fix: "name a recording, or a folder that contains recordings"
       )}
    end
  end

  defp parse_address(text) do
    case text |> String.to_charlist() |> :inet.parse_address() do
      {:ok, ip} ->
        {:ok, ip}

      {:error, _} ->
        {:error,
         Error.new(:bad_address, "invalid address: #{inspect(text)}",
           fix: "write it like 0.0.0.0 or ::1"
         )}
    end
  end

  defp tls_settings(opts) do
    case {opts[:certificate], opts[:key]} do
      {nil, nil} ->
        {:ok, if(opts[:tls], do: :own, else: [])}

      {certificate, key} when is_binary(certificate) and is_binary(key) ->
        {:ok, [certfile: certificate, keyfile: key]}

      _ ->
        {:error,
         Error.new(:usage, "--certificate and --key must be given together",
           fix: "name both files, or use --tls for a certificate generated for this machine"
         )}
    end
  end

  defp start_studio(path, ip, opts) do
    Process.flag(:trap_exit, true)

    Studio.start_link(
      [path: path, ip: ip, port: opts[:port], read_only: opts[:read_only], tls: opts[:tls]] ++
        [plugins: Plugin.load_plugins(opts[:plugins])] ++
        [tiles: opts[:tiles], tiles_credit: opts[:tiles_credit]] ++
        [prefix: opts[:prefix], public: opts[:public]] ++
        if(opts[:secret], do: [token: opts[:secret]], else: []) ++
        if(opts[:layouts], do: [layouts: opts[:layouts]], else: [])
    )
  end

  @doc "Starts a studio that shows the experiments over a dataset, and prints and opens its address."
  @spec show_experiments(Path.t(), keyword()) :: Supervisor.supervisor()
  def show_experiments(dataset, opts) do
    for app <- [:situ_bridge, :situ_link, :situ_studio],
        do: {:ok, _} = Application.ensure_all_started(app)

    # Port 4040 may be in use by another studio.
    {:ok, studio} = Studio.start_link(path: dataset, port: 0)
    url = Studio.experiments_url(studio, Studio.only_item(studio))
    print = if opts[:json], do: &Output.warn/1, else: &Output.puts/1
    print.("Situ Studio shows the experiments over #{dataset} at #{url}")
    Situ.CLI.Desktop.open_url(url)
    studio
  end

  @doc "Serves a studio until SIGTERM or until it ends; returns the exit status."
  @spec wait_for_exit(Supervisor.supervisor()) :: 0 | 1
  # Service managers stop the studio with SIGTERM.
  def wait_for_exit(studio) do
    Interrupt.with_message(:stop, fn ->
      receive do
        :stop ->
          Supervisor.stop(studio, :shutdown)
          0

        {:EXIT, ^studio, reason} ->
          Output.warn("situ studio: the studio ended: #{inspect(reason)}")
          1
      end
    end)
  end
end
