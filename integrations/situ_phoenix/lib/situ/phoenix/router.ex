defmodule Situ.Phoenix.Router do
  @moduledoc """
  Mounts the studio in the router of a Phoenix application.

      defmodule MyAppWeb.Router do
        use MyAppWeb, :router
        import Situ.Phoenix.Router

        scope "/" do
          pipe_through [:browser, :require_authenticated_user]
          situ_studio "/situ", recordings: "recordings"
        end
      end
  """

  @doc """
  Serves a studio under `path`, after the pipelines of the scope. It starts at the first request.

  Options:

    * `:recordings` - a recording, or a folder that contains recordings at any depth
    * `:pipelines` - running pipelines to show, by their names
    * `:read_only` - rejects every change to files on disk
    * `:viewer?` - `{module, function}`, called with the `Plug.Conn`, such as `{MyAppWeb.UserAuth, :guest?}`. If it
    returns
      true, the server refuses to change, write or run anything for that user
    * `:hosts` - host names that the studio accepts, or `:any`; default: the host of the endpoint's `url:` and the
      loopback names
    * all others of `Situ.Studio` except `:path`, `:port`, `:ip`, `:tls`, `:token`, `:public`, `:prefix` and `:id`

  Options that are known only at run time, and functions, come from a function:

      situ_studio "/situ", {MyApp.Lab, :studio_options, []}
  """
  defmacro situ_studio(path, opts \\ []) do
    quote bind_quoted: [path: path, opts: opts] do
      # A module can be forwarded to only once in a router, which would permit only one studio.
      scope path, alias: false, as: false do
        match(:*, "/*situ_path", Situ.Phoenix.Plug, opts)
      end
    end
  end
end
