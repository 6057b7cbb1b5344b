defmodule Situ.CLI.Studio do
  @moduledoc "`situ studio`: recordings in the browser."
  @behaviour Situ.CLI.Verb

  alias Situ.CLI.{Option, Output, Plugin, Secret, Verb}
  alias Situ.{Error, Studio}

  @impl true
  def verbs do
    [
      %Verb{
        words: ["studio"],
        summary: "look at recordings in the browser: scrub, play, watch live",
        about: """
        Serves the studio until it is stopped (Ctrl-C) and opens the browser. PATH is a recording, or a folder that
        holds recordings at any depth; default: the folder "recordings", else this one. A recording that is being
        written is followed live.
        """,
        arguments: [
          path: [kind: :recording, optional: true, doc: "a recording, or a folder of recordings"]
        ],
        options: [
          Option.new(:port, :integer, "listen on this port; 0 takes a free one", default: 4040),
          Option.new(
            :listen,
            :string,
            "listen on this address; elsewhere a browser must bring a token",
            value: "ADDRESS",
            default: "127.0.0.1"
          ),
          Secret.option(
            "the file that holds the token (8 characters or more) in place of a random one; so does SITU_TOKEN"
          ),
          Option.new(
            :token,
            :string,
            "the token itself, which every user of the machine can read"
          ),
          Option.new(:tls, :flag, "speak https, by a certificate made for this machine"),
          Option.new(:certificate, :path, "speak https by this certificate (PEM)"),
          Option.new(:key, :path, "the certificate's key (PEM)"),
          Option.new(
            :layouts,
            :path,
            "where layouts are saved (default: the user's configuration folder)"
          ),
          Option.new(:plugins, :path, "a folder of plug-ins, or of one; see `situ plugin --help`",
            many?: true
          ),
          Option.new(
            :tiles,
            :string,
            "pictures for maps: https://.../{z}/{x}/{y}.png, or a folder of such files",
            value: "URL"
          ),
          Option.new(:tiles_credit, :string, "who made them, to be named on the map",
            value: "TEXT"
          ),
          Option.new(:read_only, :flag, "nothing on disk can be changed"),
          Option.new(:open, :flag, "do not open the browser", negated?: true)
        ],
        examples: ["situ studio recordings/lobby --port 4041"],
        run: fn %{path: path}, opts -> serve(path, opts) end
      }
    ]
  end

  defp serve(path, opts) do
    # Recordings of other systems are shown too.
    for app <- [:situ_bridge, :situ_remote, :situ_studio],
        do: {:ok, _} = Application.ensure_all_started(app)

    path = path || if(File.dir?("recordings"), do: "recordings", else: ".")

    with :ok <- check_path(path),
         {:ok, ip} <- address(opts[:listen]),
         {:ok, tls} <- tls(opts),
         {:ok, token} <- Secret.token(opts),
         {:ok, studio} <- start(path, ip, [tls: tls, secret: token] ++ opts) do
      url = Studio.url(studio, Studio.only_item(studio))
      Output.puts("Situ Studio shows #{path} at #{url}")
      if opts[:open], do: Situ.CLI.Desktop.open(url)
      wait(studio)
    else
      {:error, error} -> raise error
    end
  end

  defp check_path(path) do
    if File.exists?(path) or Situ.Store.Formats.for_address(path) do
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

  defp tls(opts) do
    case {opts[:certificate], opts[:key]} do
      {nil, nil} ->
        {:ok, if(opts[:tls], do: :own, else: [])}

      {certificate, key} when is_binary(certificate) and is_binary(key) ->
        {:ok, [certfile: certificate, keyfile: key]}

      _ ->
        {:error,
         Error.new(:usage, "--certificate and --key go together",
           fix: "name both files, or take --tls for a certificate made for this machine"
         )}
    end
  end

  defp start(path, ip, opts) do
    Process.flag(:trap_exit, true)

    Studio.start_link(
      [path: path, ip: ip, port: opts[:port], read_only: opts[:read_only], tls: opts[:tls]] ++
        [plugins: Plugin.load(opts[:plugins])] ++
        [tiles: opts[:tiles], tiles_credit: opts[:tiles_credit]] ++
        if(opts[:secret], do: [token: opts[:secret]], else: []) ++
        if(opts[:layouts], do: [layouts: opts[:layouts]], else: [])
    )
  end

  defp wait(studio) do
    receive do
      {:EXIT, ^studio, reason} ->
        Output.warn("situ studio: the studio ended: #{inspect(reason)}")
        1
    end
  end
end
