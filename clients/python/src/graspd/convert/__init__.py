"""Grasps as other libraries take them: `convert.ros`, `convert.scipy`, `convert.meshes`.

Each is imported by itself, since each but `ros` needs an extra: `pip install 'graspd[scipy]'`, `'graspd[mesh]'`.
"""
