defmodule Situ.KnownModulesTest do
  use ExUnit.Case, async: true
  alias Situ.KnownModules

  doctest KnownModules

  test "refuses a name that is not a module and creates no atom" do
    name = "Elixir.Never#{System.unique_integer([:positive])}"
    assert KnownModules.fetch_module(name) == :error
    assert_raise ArgumentError, fn -> String.to_existing_atom(name) end
    # This atom exists but is not a module.
    refute KnownModules.ensure_loaded?(:ok)
  end

  @tag :tmp_dir
  test "a file in the code path is not sufficient", %{tmp_dir: folder} do
    module = :"Elixir.Filed#{System.unique_integer([:positive])}"
    {:ok, ^module, beam} = :compile.forms([{:attribute, 1, :module, module}])
    File.write!(Path.join(folder, "#{module}.beam"), beam)
    true = Code.prepend_path(folder)
    refute KnownModules.ensure_loaded?(module)

    app = :"filed_app_#{System.unique_integer([:positive])}"
    :ok = :application.load({:application, app, vsn: '1', modules: [module], applications: []})
    assert KnownModules.fetch_module(Atom.to_string(module)) == {:ok, module}
    Application.unload(app)
    Code.delete_path(folder)
  end
end
