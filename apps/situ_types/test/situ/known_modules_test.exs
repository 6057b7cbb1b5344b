defmodule Situ.KnownModulesTest do
  use ExUnit.Case, async: true
  alias Situ.KnownModules

  doctest KnownModules

  test "a name that is no module's is refused, and makes no atom" do
    name = "Elixir.Never#{System.unique_integer([:positive])}"
    assert KnownModules.fetch(name) == :error
    assert_raise ArgumentError, fn -> String.to_existing_atom(name) end
    # An atom that is there, of no module.
    refute KnownModules.load?(:ok)
  end

  @tag :tmp_dir
  test "a file in the code path is not enough", %{tmp_dir: folder} do
    module = :"Elixir.Filed#{System.unique_integer([:positive])}"
    {:ok, ^module, beam} = :compile.forms([{:attribute, 1, :module, module}])
    File.write!(Path.join(folder, "#{module}.beam"), beam)
    true = Code.prepend_path(folder)
    refute KnownModules.load?(module)

    app = :"filed_app_#{System.unique_integer([:positive])}"
    :ok = :application.load({:application, app, vsn: '1', modules: [module], applications: []})
    assert KnownModules.fetch(Atom.to_string(module)) == {:ok, module}
    Application.unload(app)
    Code.delete_path(folder)
  end
end
